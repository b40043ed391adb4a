"""What is compared with what (calibration.md#without-labels), and how alike it looks.

Letters: `V` views, `S` comparisons, `M` views of a memory, `A` appearance channels, `R` rings, `K`
parts, `D` feature dimension.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any

import jax
import numpy as np
from jaxtyping import Bool, Float, Int

from remind_jax.calibration.estimate import Evidence, join
from remind_jax.numerics.pytree import pytree

NONE = -1
VIEWS = 8  # of a memory
QUERIES = 6  # of a tracklet
OTHERS = 6  # memories of other objects of the same class that a query is compared with, and of any
TRACKS = 400  # of a scene that take part
SHORTEST = 6  # views of a tracklet that takes part


@pytree
class Sightings:
    """Which object, or tracklet, is seen in which view; views by rising frame."""

    frame: Int[np.ndarray, "V"]
    track: Int[np.ndarray, "V"]  # -1 where nothing is known
    class_id: Int[np.ndarray, "V"]


@pytree
class Comparisons:
    """Pairs of a query and a memory."""

    query: Int[np.ndarray, "S"]  # a view
    memory: Int[np.ndarray, "S M"]  # views, -1 beyond the last
    same: Bool[np.ndarray, "S"]  # both show one object
    same_class: Bool[np.ndarray, "S"]

    def only(self, chosen: Bool[np.ndarray, "S"]) -> Comparisons:
        """Some of them."""
        return jax.tree.map(lambda array: array[chosen], self)

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
                rows += _rows(seen, int(query), track, others, memories, rng)
    return Comparisons.of(rows)


def _rows(
    seen: Sightings,
    query: int,
    track: int,
    others: list[int],
    memories: Mapping[int, np.ndarray],
    rng: np.random.Generator,
) -> list[tuple[int, np.ndarray, bool, bool]]:
    """A query with what is remembered of its own object, and of some others."""
    rows = [(query, _spread(memories[track], VIEWS), True, True)]
    class_of = {one: seen.class_id[memories[one][0]] for one in others}
    for alike in (True, False):
        of_kind = [one for one in others if (class_of[one] == seen.class_id[query]) == alike]
        for one in _choose(of_kind, OTHERS, rng):
            rows.append((query, _spread(memories[one], VIEWS), False, alike))
    return rows


def _choose(of: list[int], most: int, rng: np.random.Generator) -> list[int]:
    """At most so many of them, drawn at random; in their order."""
    if len(of) <= most:
        return of
    return [of[place] for place in np.sort(rng.choice(len(of), most, replace=False))]


def _spread(of: np.ndarray, most: int) -> np.ndarray:
    """At most so many of them, evenly spread from the first to the last."""
    return of[np.unique(np.linspace(0, len(of) - 1, min(most, len(of))).round().astype(int))]


_AT_ONCE = 64  # comparisons


@pytree
class Views:
    """Unit vectors of detections, zero where not present (method.md#described-frame)."""

    appearance: Float[np.ndarray, "V A D"]
    appearance_seen: Bool[np.ndarray, "V A"]
    rings: Float[np.ndarray, "V R D"]
    rings_seen: Bool[np.ndarray, "V R"]
    parts: Float[np.ndarray, "V K D"]  # by falling support
    parts_seen: Bool[np.ndarray, "V K"]

    @property
    def num_bytes(self) -> int:
        """Memory that the arrays take."""
        return sum(array.nbytes for array in jax.tree.leaves(self))

    def part_cosines(self) -> Float[np.ndarray, "P"]:
        """Cosines between the parts of one view."""
        first, second = np.triu_indices(self.parts.shape[1], 1)
        cosines = np.einsum("vkd,vkd->vk", self.parts[:, first], self.parts[:, second])
        return cosines[self.parts_seen[:, first] & self.parts_seen[:, second]].astype(float)

    def merge_parts(self, merge: float) -> Views:
        """Without parts that are closer than this to a stronger one (method.md#k-means-parts)."""
        seen = self.parts_seen.copy()
        for part in range(1, seen.shape[1]):
            for stronger in range(part):
                cosine = np.sum(self.parts[:, part] * self.parts[:, stronger], axis=-1)
                seen[:, part] &= ~(seen[:, stronger] & (cosine > merge))
        return dataclasses.replace(self, parts_seen=seen)


def compare_views(
    views: Views, comparisons: Comparisons, ring_shares: tuple[float, float], part_top: int
) -> Evidence:
    """Terms of the visual score of each query with a memory, as the tracker has them.

    Rules: method.md#channel-scores, method.md#visual-score.
    """
    parts = [Evidence(np.zeros((0, 3)), np.zeros((0, 3), bool))]
    for first in range(0, len(comparisons.query), _AT_ONCE):
        some = slice(first, first + _AT_ONCE)
        query, memory = comparisons.query[some], comparisons.memory[some]
        terms = (
            _best_channel(views, query, memory),
            _join_rings(views, query, memory, ring_shares),
            _best_parts(views, query, memory, part_top),
        )
        value, present = (np.stack(columns, axis=1) for columns in zip(*terms, strict=True))
        parts.append(Evidence(value.astype(float), present))
    return join(parts)


def _nearest(
    vectors: Float[np.ndarray, "V C D"],
    seen: Bool[np.ndarray, "V C"],
    query: np.ndarray,
    memory: np.ndarray,
) -> tuple[Float[np.ndarray, "S C"], Bool[np.ndarray, "S C"]]:
    """Best cosine of each channel of a query, and whether both sides have the channel."""
    cosine = np.einsum("scd,smcd->smc", vectors[query], vectors[memory])
    both = seen[query][:, None] & seen[memory] & (memory != NONE)[:, :, None]
    return np.where(both, np.maximum(cosine, 0.0), 0.0).max(axis=1), both.any(axis=1)


def _best_channel(views: Views, query: np.ndarray, memory: np.ndarray) -> tuple[Any, Any]:
    best, present = _nearest(views.appearance, views.appearance_seen, query, memory)
    return best.max(axis=1), np.any(present, axis=1)


def _join_rings(
    views: Views, query: np.ndarray, memory: np.ndarray, shares: tuple[float, float]
) -> tuple[Any, Any]:
    best, present = _nearest(views.rings, views.rings_seen, query, memory)
    counted = np.array(shares) * present
    joint = (best * counted).sum(axis=1) / np.maximum(counted.sum(axis=1), 1e-12)
    return joint, np.any(present, axis=1)


def _best_parts(views: Views, query: np.ndarray, memory: np.ndarray, top: int) -> tuple[Any, Any]:
    cosine = np.einsum("skd,smjd->skmj", views.parts[query], views.parts[memory])
    there = views.parts_seen[memory] & (memory != NONE)[:, :, None]
    both = views.parts_seen[query][:, :, None, None] & there[:, None]
    best = np.where(both, np.maximum(cosine, 0.0), -1.0).max(axis=(2, 3))
    best = -np.sort(-best, axis=1)[:, :top]
    count = (best >= 0).sum(axis=1)
    mean = np.where(best >= 0, best, 0.0).sum(axis=1) / np.maximum(count, 1)
    return mean, count > 0
