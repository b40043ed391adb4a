"""What is compared with what (calibration.md#without-labels).

Letters: `V` views, `S` comparisons, `M` views of a memory.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np
from jaxtyping import Bool, Int

NONE = -1
VIEWS = 8  # of a memory
QUERIES = 6  # of a tracklet
OTHERS = 6  # memories of other objects of the same class that a query is compared with, and of any
TRACKS = 400  # of a scene that take part
SHORTEST = 6  # views of a tracklet that takes part


@dataclasses.dataclass(frozen=True)
class Sightings:
    """Which object, or tracklet, is seen in which view; views by rising frame."""

    frame: Int[np.ndarray, "V"]
    track: Int[np.ndarray, "V"]  # -1 where nothing is known
    class_id: Int[np.ndarray, "V"]


@dataclasses.dataclass(frozen=True)
class Comparisons:
    """Pairs of a query and a memory."""

    query: Int[np.ndarray, "S"]  # a view
    memory: Int[np.ndarray, "S M"]  # views, -1 beyond the last
    same: Bool[np.ndarray, "S"]  # both show one object
    same_class: Bool[np.ndarray, "S"]

    def only(self, chosen: Bool[np.ndarray, "S"]) -> Comparisons:
        """Some of them."""
        arrays = dataclasses.asdict(self)
        return Comparisons(**{name: array[chosen] for name, array in arrays.items()})

    @staticmethod
    def of(rows: list[tuple[int, np.ndarray, bool, bool]]) -> Comparisons:
        """Comparisons from rows of query, memory, same, same class."""
        memory = np.full((len(rows), VIEWS), NONE, np.int32)
        for place, (_, views, _, _) in enumerate(rows):
            memory[place, : len(views)] = views
        return Comparisons(
            query=np.array([row[0] for row in rows], np.int32),
            memory=memory,
            same=np.array([row[2] for row in rows], bool),
            same_class=np.array([row[3] for row in rows], bool),
        )


def compare_ends(seen: Sightings, rng: np.random.Generator) -> Comparisons:
    """Ends of tracklets with each other (calibration.md#without-labels)."""
    views = {
        track: np.flatnonzero(seen.track == track)
        for track in np.unique(seen.track[seen.track != NONE])
    }
    chosen = _choose([track for track, at in views.items() if len(at) >= SHORTEST], TRACKS, rng)
    frames = {track: set(seen.frame[views[track]].tolist()) for track in chosen}
    first = {track: views[track][: len(views[track]) // 3] for track in chosen}
    last = {track: views[track][-(len(views[track]) // 3) :] for track in chosen}
    rows = []
    for track in chosen:
        others = [one for one in chosen if one != track and frames[one] & frames[track]]
        for queries, memories in ((last, first), (first, last)):
            for query in _spread(queries[track], QUERIES // 2):
                rows += _rows(seen, int(query), track, others, memories.__getitem__, rng)
    return Comparisons.of(rows)


def _rows(
    seen: Sightings,
    query: int,
    track: int,
    others: list[int],
    remembered: Callable[[int], np.ndarray],
    rng: np.random.Generator,
) -> list[tuple[int, np.ndarray, bool, bool]]:
    """A query with what is remembered of its own object, and of some others."""
    rows = [(query, _spread(remembered(track), VIEWS), True, True)]
    class_of = {one: seen.class_id[remembered(one)[0]] for one in others}
    for alike in (True, False):
        of_kind = [one for one in others if (class_of[one] == seen.class_id[query]) == alike]
        for one in _choose(of_kind, OTHERS, rng):
            rows.append((query, _spread(remembered(one), VIEWS), False, alike))
    return rows


def _choose(of: list[int], most: int, rng: np.random.Generator) -> list[int]:
    """At most so many of them, drawn at random; in their order."""
    if len(of) <= most:
        return of
    return [of[place] for place in np.sort(rng.choice(len(of), most, replace=False))]


def _spread(of: np.ndarray, most: int) -> np.ndarray:
    """At most so many of them, evenly spread from the first to the last."""
    return of[np.unique(np.linspace(0, len(of) - 1, min(most, len(of))).round().astype(int))]
