"""The identities that people are told of: announced, recorded, named, and found to be one.

The memory decides about objects under ids of its own; answers speak of what was announced of them.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Collection, Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import UInt8

from remind_jax.decision import NO_ID, Outcome, Reason
from remind_jax.formats.firm import main_labels
from remind_jax.outputs.run_records import Event
from remind_jax.printing.words import plural
from remind_jax.session.announcement import Announcements, announce, announce_late, as_announced
from remind_jax.session.memory_file import SavedMemory
from remind_jax.session.object_records import ObjectRecords
from remind_jax.tracks import Tracks

if TYPE_CHECKING:
    from remind_jax.outputs.writer import KeptTracks

_FEW_TOLD = 256  # objects whose records are kept, whether memory still has them or not


class Identities:
    """What is told of the objects of one memory.

    Attributes:
      announce_after: Detections after which an object gets its id.
      announcements: Which objects got one so far.
      records: Of each object that was answered, by announced ids.
      decided: The last frame, by ids of the memory; None before the first.
      merges: Objects that turned out to be others in it, beside those; by ids of the memory.
    """

    def __init__(self, announce_after: int, first_id: int) -> None:
        """Knows no object yet; the first one announced late will have `first_id`."""
        self.announce_after = announce_after
        at_once = announce_after <= 1
        self.announcements = Announcements() if at_once else Announcements.all_below(first_id)
        self.records = ObjectRecords()
        self.decided: Tracks | None = None
        self.merges: list[tuple[int, int]] = []
        self._is_new_session = False
        self._most_told = _FEW_TOLD

    def restore(self, memory: SavedMemory) -> None:
        """Goes on with those of a memory, in a session of its own that begins with the next frame.

        Objects of a memory without announcements were announced under the ids that they have there.
        """
        self.announcements = memory.announced
        if memory.announced.is_identity and self.announce_after > 1:
            self.announcements = Announcements.all_below(int(memory.state.next_id))
        self.records, self._is_new_session = memory.records, True

    def resume(self, merged_into: Mapping[int, int]) -> None:
        """After `restore`: as if the frames of the memory had been of this session.

        Objects that turned out to be others in them are named by ids of the memory.
        """
        self.announcements = dataclasses.replace(self.announcements, merged_into=merged_into)
        self._is_new_session = False

    def add(
        self,
        decided: Tracks,
        merges: Sequence[tuple[int, int]],
        image: UInt8[np.ndarray, "H W 3"] | None,
        known_ids: Callable[[], Collection[int]],
    ) -> tuple[Tracks, list[Event]]:
        """The answers about the next frame, and which objects turned out to be one.

        Args:
          decided: By ids of the memory.
          merges: Ids of what turned out to be other objects, answered or not, beside those.
          image: RGB; None if no pictures of objects are to be kept.
          known_ids: Gives the ids that the memory still has; called only now and then.
        """
        before = self.announcements
        if self._is_new_session:
            self.records.session += 1
            self._is_new_session = False
        self.decided = decided
        self.merges = [
            (gone, kept)
            for gone, kept in merges
            if gone in before.counts or self.records.has(before.id_of(gone))
        ]
        self.announcements = announce(self.announcements, decided, self.announce_after, self.merges)
        events = []
        for gone, kept in self.merges:
            old, new = before.id_of(gone), self.announcements.id_of(kept)
            if NO_ID not in (old, new) and old != new:
                old, new = self.records.merge_for_good(old, new)
                if old != new:
                    message = f"object {old} turned out to be object {new}"
                    events.append(Event(decided.frame_index, "merged", message, (old, new)))
        announced = self._with_first_ones(as_announced(self.announcements, decided))
        self.records.note(announced, image)
        if self._num_told() > self._most_told:
            # Memory has no more what many of the records are of; they go before they become more.
            known = known_ids()
            self.records.keep({self.announcements.id_of(one) for one in known})
            self.announcements = self.announcements.among(known)
            self._most_told = max(_FEW_TOLD, self._num_told() * 5 // 4)
        return self.records.answer(announced), events

    def tell_lost(
        self, ids: Collection[int], frame_index: int, known_ids: Callable[[], Collection[int]]
    ) -> list[Event]:
        """Which of the ids that memory let go before they were objects in it had been answered."""
        why = "forgotten: it was gone before it was decided"
        return [
            Event(frame_index, "forgotten", f"object {one} {why}", (one,))
            for one in self._no_more_answered(ids, known_ids)
        ]

    def tell_excess(
        self,
        ids: Collection[int],
        most: int,
        frame_index: int,
        known_ids: Callable[[], Collection[int]],
    ) -> list[Event]:
        """That memory let these go, as more than `most` were known."""
        if not ids:
            return []
        message = f"{plural(len(ids), 'object')} forgotten, as more than {most} were known"
        told = self._no_more_answered(ids, known_ids)
        return [Event(frame_index, "forgotten", message, told)]

    def answer(self, decided: Tracks) -> Tracks:
        """The answers about a frame that was decided, by what is announced, named and merged."""
        return self.records.answer(as_announced(self.announcements, decided))

    def conclude(self, run: Sequence[Tracks] | KeptTracks) -> tuple[Tracks, ...]:
        """The final answers about all frames that were decided, which the records then agree with.

        Frames are given by ids of the memory, with what later ones changed.
        """
        self.announcements = announce_late(self.announcements, run, self.announce_after)
        announced = [as_announced(self.announcements, decided) for decided in run]
        self.records.recount(announced)
        answered = [self.records.answer(tracks) for tracks in announced]
        classes = main_labels(answered, [tracks.object_id for tracks in answered])
        return tuple(dataclasses.replace(tracks, classes=classes) for tracks in answered)

    def _with_first_ones(self, announced: Tracks) -> Tracks:
        """The answers, new where an object never had one: it may have been known unannounced."""
        outcome, reason = announced.outcome.copy(), announced.reason.copy()
        for row in np.flatnonzero(outcome == Outcome.MATCH).tolist():
            if not self.records.has(int(announced.object_id[row])):
                outcome[row], reason[row] = Outcome.NEW, Reason.CREATED_NEW
        return dataclasses.replace(announced, outcome=outcome, reason=reason)

    def _no_more_answered(
        self, ids: Collection[int], known_ids: Callable[[], Collection[int]]
    ) -> tuple[int, ...]:
        """The answered ids of what memory let go, but for those that it has another object of."""
        announced = {self.announcements.id_of(one) for one in ids}
        gone = {one for one in announced if self.records.has(one)}
        if not gone:
            return ()
        merged_into = self.records.merged_into
        known = self.records.with_merged({self.announcements.id_of(one) for one in known_ids()})
        return tuple(sorted({merged_into.get(one, one) for one in gone} - known))

    def _num_told(self) -> int:
        return self.records.num_records + len(self.announcements.counts)
