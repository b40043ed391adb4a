"""When an object gets its id in the answers: detectors see things for a frame that never were.

An object is announced once it was detected often enough, under the next free number: ids of what
never was leave no gaps. Until then its detections are reported as provisional. An id that was
announced stays. Tracks "as decided" carry the ids of the memory, tracks "as announced" the others.
"""

from __future__ import annotations

import dataclasses
import numbers
import sys
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Mapping

import msgspec
import numpy as np
from jaxtyping import Float, Int

from remind_jax.decision import NO_ID, Outcome, Reason
from remind_jax.errors import OptionError
from remind_jax.files.records import Small, Whole
from remind_jax.tracks import Tracks

# Detections from which on an object of a detector is announced (`benchmarks/announcement.py`).
DETECTOR_DEFAULT = 5

_ALL = sys.maxsize


@dataclasses.dataclass(frozen=True)
class Announcements:
    """Which objects were announced, and how often the others were detected.

    Objects are named by the ids of the memory, unless something else is said.
    """

    known_below: int = _ALL  # objects with lower ids were announced under these
    ids: Mapping[int, int] = dataclasses.field(default_factory=dict)  # of all others announced
    counts: Mapping[int, int] = dataclasses.field(default_factory=dict)  # detections of the rest
    merged_into: Mapping[int, int] = dataclasses.field(default_factory=dict)  # by the tracker
    next_id: int = _ALL  # number of the next object announced

    @classmethod
    def all_below(cls, object_id: int) -> Announcements:
        """All objects with lower ids were announced under these, no other; that id is the next."""
        return cls(known_below=object_id, next_id=object_id)

    def filed(self) -> FiledAnnouncements:
        """What a later run needs to go on."""
        ids, counts = ([*pairs.items()] for pairs in (self.ids, self.counts))
        return FiledAnnouncements(self.known_below, self.next_id, ids, counts)

    @property
    def is_identity(self) -> bool:
        """Whether every object is announced at once under the id that it has in memory."""
        return self.known_below == _ALL

    def id_of(self, object_id: int) -> int:
        """The announced id, NO_ID without any."""
        while object_id >= self.known_below and object_id not in self.ids:
            if object_id not in self.merged_into:
                return NO_ID
            object_id = self.merged_into[object_id]
        return self.ids.get(object_id, object_id)

    def memory_ids(self, announced_id: int) -> tuple[int, ...]:
        """The ids that memory may have an announced object under."""
        if announced_id < self.known_below:
            return (announced_id,)
        return tuple(one for one, number in self.ids.items() if number == announced_id)

    def waits(self, object_id: int) -> bool:
        """Whether it is an object that was not announced."""
        return object_id >= self.known_below and object_id not in self.ids

    def among(self, object_ids: Collection[int]) -> Announcements:
        """Without counts of what memory lost: a number that was let go never comes back."""
        counts = {one: count for one, count in self.counts.items() if one in object_ids}
        return dataclasses.replace(self, counts=counts)

    def joined(
        self, other: Announcements, ids: Mapping[int, int]
    ) -> tuple[Announcements, dict[int, int]]:
        """With the objects of another memory, and the id announced here of each one there.

        `ids` has of each object there its id in this memory, higher than all before.
        """
        known = {one: number for one in ids if (number := other.id_of(one)) != NO_ID}
        if self.is_identity:
            return self, {number: ids[one] for one, number in known.items()}
        number_of = {
            number: self.next_id + place for place, number in enumerate(sorted({*known.values()}))
        }
        now = dataclasses.replace(
            self,
            ids={**self.ids, **{ids[one]: number_of[known[one]] for one in known}},
            counts={**self.counts, **{ids[i]: n for i, n in other.counts.items() if i in ids}},
            next_id=self.next_id + len(number_of),
        )
        return now, number_of

    def number(self, object_ids: Iterable[int]) -> dict[int, int]:
        """A number for each of these, for explanations.

        Announced objects have their id, all others the numbers that follow the announced ones.
        """
        ids = sorted({int(i) for i in object_ids} - {NO_ID})
        direct = {i: i if i < self.known_below else self.ids.get(i, NO_ID) for i in ids}
        rest = [i for i in ids if direct[i] == NO_ID]
        return direct | {i: self.next_id + place for place, i in enumerate(rest)} | {NO_ID: NO_ID}


class FiledAnnouncements(msgspec.Struct, frozen=True):
    """What was announced, as a memory file has it."""

    known_below: Whole
    next_id: Whole
    ids: list[tuple[Small, Whole]]
    counts: list[tuple[Small, Whole]]

    def restored(self) -> Announcements:
        """The same as it was."""
        return Announcements(self.known_below, dict(self.ids), dict(self.counts), {}, self.next_id)


def choose_after(asked: int | None, configured: int, has_detector: bool) -> int:
    """Detections after which objects are announced.

    Args:
      asked: What the caller wants; None or 0 leaves it to the configuration.
      configured: `input.announce_after`; 0 leaves it to the kind of detections: 1 for given masks,
        else `DETECTOR_DEFAULT`.

    Raises:
      OptionError: If what is asked for is no number of detections.
    """
    is_count = isinstance(asked, numbers.Integral) and int(asked) >= 0
    if asked is not None and (isinstance(asked, bool) or not is_count):
        raise OptionError(
            f"'announce_after' is {asked!r}; give a number of detections from 1 on, or 0 for 1 "
            f"with given masks and {DETECTOR_DEFAULT} with a detector",
            "announce_after",
        )
    return asked or configured or (DETECTOR_DEFAULT if has_detector else 1)


def announce(
    so_far: Announcements, tracks: Tracks, after: int, merges: Iterable[tuple[int, int]] = ()
) -> Announcements:
    """What is announced when a frame was decided.

    Args:
      after: Detections after which an object is announced; a frame counts once.
      merges: Objects that turned out to be others in this frame, beside those.
    """
    if so_far.is_identity:
        return so_far
    seen = sorted({int(i) for i in tracks.object_id if so_far.waits(int(i))})
    merges = list(merges)
    if not seen and not merges:
        return so_far
    ids, counts, merged = dict(so_far.ids), dict(so_far.counts), dict(so_far.merged_into)
    for gone, kept in merges:
        merged[gone] = kept
        known = so_far.id_of(gone)
        if known != NO_ID and so_far.waits(kept):
            # To whoever reads the answers, the two were one object all along.
            ids.setdefault(kept, known)
        counts[kept] = counts.get(kept, 0) + counts.pop(gone, 0)
    next_id = so_far.next_id
    for object_id in seen:
        counts[object_id] = counts.get(object_id, 0) + 1
        if object_id not in ids and counts[object_id] >= after:
            ids[object_id], next_id = next_id, next_id + 1
    waiting = {i: n for i, n in counts.items() if i not in ids and so_far.waits(i)}
    return Announcements(so_far.known_below, ids, waiting, merged, next_id)


def announce_late(so_far: Announcements, run: Iterable[Tracks], after: int) -> Announcements:
    """What is announced besides once all frames are told.

    An object of which later frames tell that it was seen before counts as often as it was seen.

    Args:
      run: By ids of the memory, with what later frames changed.
    """
    ids, counts = dict(so_far.ids), Counter[int]()
    for tracks in () if so_far.is_identity else run:
        counts.update({int(i) for i in tracks.object_id if so_far.waits(int(i))})
    often = [one for one, count in counts.items() if count >= after]
    ids |= {one: so_far.next_id + place for place, one in enumerate(often)}
    waiting = {one: count for one, count in so_far.counts.items() if one not in ids}
    next_id = so_far.next_id + len(often)
    return dataclasses.replace(so_far, ids=ids, counts=waiting, next_id=next_id)


def as_announced(announced: Announcements, tracks: Tracks) -> Tracks:
    """The answers about a frame by what is announced.

    What is not announced is provisional, its pending id is the id that it has in memory. No id is
    given to two objects of a frame: of those that became one, the one announced first has it.
    """
    if announced.is_identity:
        return tracks
    object_id = _name_rows(announced, tracks.object_id)
    waits = (tracks.object_id != NO_ID) & (object_id == NO_ID)
    candidate_id, candidate_score = rename_candidates(tracks, announced.id_of)
    candidate_id[waits], candidate_score[waits] = NO_ID, 0.0
    outcome, reason = tracks.outcome.copy(), tracks.reason.copy()
    for row, decided in enumerate(outcome.tolist()):  # as integers, which compare faster
        if decided in (Outcome.AMBIGUOUS, Outcome.PROVISIONAL_PARENT):
            options = tracks.candidate_id[row][tracks.candidate_id[row] != NO_ID]
            num_named = np.sum(candidate_id[row] != NO_ID)
            if len(options) and announced.id_of(int(options[0])) == NO_ID:
                outcome[row], reason[row] = Outcome.PROVISIONAL_NEW, Reason.UNCERTAIN_NEW
            elif num_named == 1 < len(options):
                outcome[row], reason[row] = Outcome.PROVISIONAL_PARENT, Reason.UNCERTAIN_PARENT
        elif decided == Outcome.NEW and _was_known(announced, int(tracks.object_id[row])):
            outcome[row], reason[row] = Outcome.MATCH, Reason.ASSIGNED
    outcome[waits], reason[waits] = Outcome.PROVISIONAL_NEW, Reason.SEEN_TOO_FEW_TIMES
    return dataclasses.replace(
        tracks,
        object_id=object_id,
        outcome=outcome,
        reason=reason,
        pending_id=np.where(waits, tracks.object_id, tracks.pending_id),
        candidate_id=candidate_id,
        candidate_score=candidate_score,
    )


def rename_candidates(
    tracks: Tracks, id_of: Callable[[int], int]
) -> tuple[Int[np.ndarray, "N C"], Float[np.ndarray, "N C"]]:
    """Candidates and scores by other ids, each once and in order; those without an id go."""
    ids = np.full_like(tracks.candidate_id, NO_ID)
    scores = np.zeros_like(tracks.candidate_score)
    for row in range(len(tracks)):
        named = [id_of(int(one)) for one in tracks.candidate_id[row]]
        columns = [c for c, one in enumerate(named) if one != NO_ID and one not in named[:c]]
        ids[row, : len(columns)] = [named[c] for c in columns]
        scores[row, : len(columns)] = tracks.candidate_score[row, columns]
    return ids, scores


def _was_known(announced: Announcements, object_id: int) -> bool:
    """Whether it became an object that has the same id and was seen before it."""
    kept = announced.merged_into.get(object_id)
    return kept is not None and announced.id_of(kept) == announced.id_of(object_id)


def _name_rows(announced: Announcements, object_id: Int[np.ndarray, "N"]) -> Int[np.ndarray, "N"]:
    """The announced id of each row; of objects that share one, the first to have it keeps it."""
    named = np.array([announced.id_of(int(i)) for i in object_id], object_id.dtype)
    rank = {i: place for place, i in enumerate(announced.ids)} if announced.merged_into else {}
    for shared in {int(i) for i in named if i != NO_ID}:
        rows = np.flatnonzero(named == shared)
        first = min({int(i) for i in object_id[rows]}, key=lambda i: _rank(announced, rank, i))
        named[rows[object_id[rows] != first]] = NO_ID
    return named


def _rank(announced: Announcements, rank: Mapping[int, int], object_id: int) -> int:
    """When it was announced, among others."""
    return -1 if object_id < announced.known_below else rank.get(object_id, len(rank))
