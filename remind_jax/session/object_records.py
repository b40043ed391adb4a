"""What people are told of the objects in memory, and what they said of them: names, and who is one.

A session is the time from an empty or a loaded memory on; they are counted from 1. Objects that
people declared to be one share an id, but each keeps its own evidence, so that they can be split
again. Ids are those of the answers, as announced.
"""

from __future__ import annotations

import collections
import dataclasses
import reprlib
from collections.abc import Collection, Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from jaxtyping import UInt8

from remind_jax.errors import SourceError, on_one_line
from remind_jax.files.limits import MAX_LABEL
from remind_jax.formats.firm import firm_rows
from remind_jax.outputs.presence import MIN_ABSENCE_FRAMES
from remind_jax.outputs.run_records import KnownObject
from remind_jax.session.answers import as_merged
from remind_jax.session.object_pictures import Pictures, best_of
from remind_jax.tracks import Tracks


@dataclasses.dataclass(frozen=True, order=True)
class Sight:
    """When an object was seen."""

    session: int  # from 1
    frame: int  # as that session counted them; after `load` a tracker counts on

    def __str__(self) -> str:
        return f"session {self.session}, frame {self.frame}"


@dataclasses.dataclass(frozen=True)
class RememberedObject(KnownObject):
    """An object in memory, as people are told of it."""

    num_frames: int  # in which its identity was firm
    first: Sight
    last: Sight
    merged: tuple[int, ...] = ()  # objects that people declared to be this one
    pictures: tuple[bytes, ...] = dataclasses.field(default=(), repr=False)  # JPEG, best first


@dataclasses.dataclass(frozen=True)
class ObjectRecord:
    """One object by itself."""

    label: str  # of most of its detections, by Boyer and Moore
    num_frames: int
    first: Sight
    last: Sight
    pictures: Pictures
    num_now: int = 0  # of these frames, those in the session of the last sight
    lead: int = 0  # detections of this class beyond those of others, as they were counted

    def frames_in(self, session: int) -> int:
        """Frames in a session that is the newest."""
        return self.num_now if self.last.session == session else 0

    def named(self, label: str, times: int = 1) -> ObjectRecord:
        """With so many more detections of a class."""
        if label == self.label:
            return dataclasses.replace(self, lead=self.lead + times)
        if times <= self.lead:
            return dataclasses.replace(self, lead=self.lead - times)
        return dataclasses.replace(self, label=label, lead=times - self.lead)

    def joined(self, other: ObjectRecord) -> ObjectRecord:
        """The two as one."""
        earlier = best_of((*self.pictures.best, *other.pictures.best))
        first, last = min(self.first, other.first), max(self.last, other.last)
        num_frames = self.num_frames + other.num_frames
        num_now = self.frames_in(last.session) + other.frames_in(last.session)
        if first.session == last.session:  # in some frames both were seen
            num_frames = num_now = min(num_frames, last.frame - first.frame + 1)
        return dataclasses.replace(
            self.named(other.label, other.lead),
            num_frames=num_frames,
            first=first,
            last=last,
            pictures=Pictures(earlier),
            num_now=num_now,
        )


class ObjectRecords:
    """A record of each object that was answered.

    Attributes:
      session: The number of this one; it goes up before the first frame of another.
      given: Names, by the object that people gave them to; replaced as a whole, never changed.
      merges: What people declared to be another object, and which, in that order; replaced as a
        whole, never changed.
    """

    def __init__(self, session: int = 1, records: Mapping[int, ObjectRecord] | None = None) -> None:
        self.session = session
        self.given: Mapping[int, str] = {}
        self.merges: Mapping[int, int] = {}
        self._records = dict(records or {})
        # Those seen in this session and before, as they were before.
        self._earlier: dict[int, ObjectRecord] = {}

    @property
    def merged_into(self) -> Mapping[int, int]:
        """What people declared to be another object, and the one whose id all have in the end."""
        last: dict[int, int] = {}
        for gone, kept in [*self.merges.items()][::-1]:  # what took in that one came later
            last[gone] = last.get(kept, kept)
        return last

    @property
    def names(self) -> Mapping[int, str]:
        """As shown, by id: of what people declared to be one, its own, else the first of others."""
        merged_into = self.merged_into
        shown = {one: name for one, name in self.given.items() if one not in merged_into}
        for one in sorted(self.given.keys() - shown.keys()):
            shown.setdefault(merged_into[one], self.given[one])
        return shown

    def note(self, tracks: Tracks, image: UInt8[np.ndarray, "H W 3"] | None) -> None:
        """Takes the answers about a frame, as announced, and pictures where there is an image."""
        now = Sight(self.session, tracks.frame_index)
        for row in firm_rows(self.answer(tracks)).tolist():
            object_id = int(tracks.object_id[row])
            record = self._records.get(object_id)
            if record is None:
                record = ObjectRecord(tracks.labels[row], 0, now, now, Pictures())
            if record.last.session < now.session:
                self._earlier[object_id] = record
            pictures = record.pictures
            away = now.frame - record.last.frame - 1
            if record.last.session != now.session or away >= MIN_ABSENCE_FRAMES:
                pictures = pictures.next_visit()
            if image is not None:
                pictures = pictures.look(image, tracks, row)
            self._records[object_id] = dataclasses.replace(
                record.named(tracks.labels[row]),
                num_frames=record.num_frames + 1,
                first=min(record.first, now),
                last=max(record.last, now),
                pictures=pictures,
                num_now=record.frames_in(now.session) + 1,
            )

    def recount(self, run: Iterable[Tracks]) -> None:
        """Counts the frames of this session anew: later ones changed what was answered.

        New objects that nothing is of any more are none, known ones are as they were before, and
        what is answered only in the end is one. `run` are all frames of the session, as announced
        in the end.
        """
        seen: dict[int, list[int]] = {}
        labels: dict[int, collections.Counter[str]] = collections.defaultdict(collections.Counter)
        for tracks in run:
            for row in firm_rows(self.answer(tracks)).tolist():
                object_id = int(tracks.object_id[row])
                seen.setdefault(object_id, []).append(tracks.frame_index)
                labels[object_id][tracks.labels[row]] += 1
        for object_id in sorted(seen.keys() - self._records.keys()):
            first = Sight(self.session, seen[object_id][0])
            self._records[object_id] = ObjectRecord("", 0, first, first, Pictures())
        declared = {*self.given, *self.merges, *self.merges.values()}
        for object_id, record in [*self._records.items()]:
            if object_id not in seen:
                if record.first.session == self.session and object_id not in declared:
                    del self._records[object_id]
                elif record.last.session == self.session:
                    self._records[object_id] = self._earlier.get(object_id, record)
                continue
            frames = seen[object_id]
            before = record.num_frames - record.frames_in(self.session)
            first = Sight(self.session, frames[0])
            if not before:
                (label, times), *_ = labels[object_id].most_common(1)
                lead = max(0, 2 * times - len(frames))
                record = dataclasses.replace(record, label=label, lead=lead)
            self._records[object_id] = dataclasses.replace(
                record,
                num_frames=before + len(frames),
                first=min(record.first, first) if before else first,
                last=Sight(self.session, frames[-1]),
                num_now=len(frames),
            )

    def merge_for_good(self, gone: int, kept: int) -> tuple[int, int]:
        """Takes an object that the tracker found to be another one; this cannot be split again.

        An id that people chose for one of the two is shown on.

        Returns:
          The id that is not shown any more, and the one that is; equal if they were one before.
        """
        old, new = (self.merged_into.get(one, one) for one in (gone, kept))
        chosen = self.merged_into.values()
        shown = old if old in chosen and new not in chosen else new
        merged = {*self.members(old), *self.members(new)} - {shown}
        if gone != shown:
            merged.discard(gone)
            given = dict(self.given)
            if gone in given:
                given.setdefault(kept, given.pop(gone))
            self.given = given
            if record := self._records.pop(gone, None):
                known = self._records.get(kept)
                self._records[kept] = known.joined(record) if known else record
        elif gone in self._records:
            self._records.setdefault(kept, self._records[gone])
        apart = {one: to for one, to in self.merges.items() if one not in {*merged, gone}}
        self.merges = {**apart, **dict.fromkeys(merged, shown)}
        return (new if shown == old else old), shown

    def answer(self, tracks: Tracks) -> Tracks:
        """The answers by names and by what was declared to be one; no id is given twice for it."""
        if self.merges:
            tracks = as_merged(tracks, self.merged_into)
        known = (one for one in tracks.object_id.tolist() if one in self._records)
        classes = {one: self._records[one].label for one in known}
        return dataclasses.replace(tracks, names=self.names, classes=classes)

    def objects(self) -> tuple[RememberedObject, ...]:
        """What is known of each object, by rising id."""
        names, others = self.names, collections.defaultdict[int, list[int]](list)
        for gone, kept in sorted(self.merged_into.items()):
            others[kept].append(gone)
        return tuple(
            self._tell(object_id, others[object_id], names.get(object_id, ""))
            for object_id in sorted(self._records)
            if object_id not in self.merges
        )

    def with_merged(self, ids: Collection[int]) -> set[int]:
        """Objects with all that are declared to be one with them."""
        merged_into = self.merged_into
        kept = {merged_into.get(one, one) for one in ids}
        return kept | {one for one, other in merged_into.items() if other in kept}

    def members(self, object_id: int) -> tuple[int, ...]:
        """An object and those that were merged into it."""
        others = (gone for gone, kept in self.merged_into.items() if kept == object_id)
        return (object_id, *sorted(others))

    def check_known(self, object_id: Any) -> int:
        """The id of an object that there is. Raises SourceError if there is none."""
        is_number = isinstance(object_id, (int, np.integer)) and not isinstance(object_id, bool)
        if is_number and int(object_id) in self.merges:
            raise SourceError(
                f"object {object_id} was merged into object {self.merged_into[int(object_id)]}; "
                "give that one, or split it first"
            )
        if not is_number or int(object_id) not in self._records:
            known = [str(one) for one in sorted(set(self._records) - set(self.merges))]
            shown = ", ".join(known[:20]) + (", ..." if len(known) > 20 else "")
            raise SourceError(f"there is no object {object_id!r}; known: {shown or 'none'}")
        return int(object_id)

    def rename(self, object_id: int, name: str) -> None:
        """Calls an object by a name, as `Tracker.rename`; by class and id if it is empty."""
        members = self.members(self.check_known(object_id))
        shown = self._records.keys() - self.merges.keys() - self.names.keys() - {*members}
        for one in shown if isinstance(name, str) else ():
            if f"{self._records[one].label} {one}" == name.strip():
                raise SourceError(
                    f"object {one} is shown as '{name}'; give another name, or merge the two"
                )
        self.restore_name(object_id, name)

    def restore_name(self, object_id: int, name: str) -> None:
        """`rename`, whatever others are shown as: later ones may be shown by any name."""
        object_id = self.check_known(object_id)
        if not isinstance(name, str) or len(name) > MAX_LABEL or on_one_line(name) != name:
            raise SourceError(
                f"an object cannot be called {reprlib.repr(name)}; give one line of text, of at "
                f"most {MAX_LABEL} characters"
            )
        name = name.strip()
        members = self.members(object_id)
        holders = [one for one in members if self.given.get(one) == name]
        if not holders and name in self.given.values():
            one = next(one for one, given in self.given.items() if given == name)
            raise SourceError(
                f"object {self.merged_into.get(one, one)} is called '{name}' already; give "
                "another name, or merge the two"
            )
        # Others that it was merged with keep theirs for when they are split, but for this name.
        given = dict(self.given)
        for one in (object_id, *holders) if name else members:
            given.pop(one, None)
        self.given = given | ({object_id: name} if name else {})

    def merge(self, kept: int, gone: Iterable[int]) -> None:
        """Declares objects to be one, which has the id of the first, as `Tracker.merge`."""
        kept = self.check_known(kept)
        ids = [self.check_known(one) for one in gone]
        if not ids or len({kept, *ids}) <= len(ids):
            raise SourceError(
                f"object {kept} cannot be merged with {', '.join(map(str, ids)) or 'nothing'}; "
                "give two or more different objects"
            )
        self.merges = {**self.merges, **dict.fromkeys(ids, kept)}

    def take_in(self, other: ObjectRecords, number_of: Mapping[int, int]) -> None:
        """Adds the objects of other records, whose sessions follow these.

        A name that an object has here is not given to another one. `number_of` are free ids here
        of the objects that come, by their ids there.
        """
        came = {number_of[one]: each for one, each in other._records.items() if one in number_of}
        sights = (sight for one in came.values() for sight in (one.first, one.last))
        sessions = sorted({sight.session for sight in sights})

        def later(sight: Sight) -> Sight:
            return Sight(self.session + 1 + sessions.index(sight.session), sight.frame)

        added = {
            one: dataclasses.replace(record, first=later(record.first), last=later(record.last))
            for one, record in came.items()
        }
        taken = set(self.given.values())
        names = {
            number_of[one]: name
            for one, name in other.given.items()
            if number_of.get(one) in added and name not in taken
        }
        merged, last = {}, other.merged_into
        for gone, kept in other.merges.items():
            into = kept if number_of.get(kept) in added else last[gone]
            if number_of.get(gone) in added and number_of.get(into) in added:
                merged[number_of[gone]] = number_of[into]
        self._records |= added
        self.given, self.merges = {**self.given, **names}, {**self.merges, **merged}
        self.session += len(sessions)

    def unite(self, pairs: Iterable[tuple[int, int]]) -> tuple[tuple[int, int], ...]:
        """Merges the second of each pair into the first; gives the pairs that were merged.

        What is merged into another one already stays there.
        """
        done = []
        for kept, gone in pairs:
            if gone not in self.merges and kept not in self.merges:
                self.merge(kept, [gone])
                done.append((kept, gone))
        return tuple(done)

    def has(self, object_id: int) -> bool:
        """Whether there is a record of it."""
        return object_id in self._records

    def split(self, object_id: int) -> tuple[int, ...]:
        """Takes back all `merge`s into an object, as `Tracker.split`.

        What was merged into one of those before stays with it.
        """
        object_id = self.check_known(object_id)
        apart = tuple(sorted(one for one, kept in self.merges.items() if kept == object_id))
        if not apart:
            raise SourceError(
                f"nothing was merged into object {object_id}, so that nothing can be split off: "
                "what the tracker took for one object from the start has no evidence of its own"
            )
        self.merges = {one: kept for one, kept in self.merges.items() if one not in apart}
        return apart

    def drop(self, object_id: int) -> None:
        """Removes the record of an object, and of all that it was merged from.

        Raises:
          SourceError: If there is no such object.
        """
        members = self.members(self.check_known(object_id))
        for one in members:
            self._records.pop(one, None)
        self.given = {one: name for one, name in self.given.items() if one not in members}
        self.merges = {one: kept for one, kept in self.merges.items() if one not in members}

    @property
    def labels(self) -> set[str]:
        """Classes of all objects that it has a record of."""
        return {record.label for record in self._records.values()}

    @property
    def num_records(self) -> int:
        """Objects that there is a record of, those that memory has no more among them."""
        return len(self._records)

    def keep(self, ids: Collection[int]) -> None:
        """Lets all that is known of other objects go, their names as well."""
        kept = self.with_merged(ids)
        self._records = {one: record for one, record in self._records.items() if one in kept}
        self.given = {one: name for one, name in self.given.items() if one in kept}
        self.merges = {one: to for one, to in self.merges.items() if one in kept}

    def kept(self, ids: Collection[int]) -> Mapping[int, ObjectRecord]:
        """The records that a memory file keeps, for `to_file`; they are replaced, never changed."""
        return {one: self._records[one] for one in sorted(self._records) if one in ids}

    def _tell(self, object_id: int, others: Sequence[int], name: str) -> RememberedObject:
        record = self._records[object_id]
        for one in others:
            record = record.joined(self._records[one])
        return RememberedObject(
            object_id=object_id,
            label=record.label,
            name=name,
            num_frames=record.num_frames,
            first=record.first,
            last=record.last,
            merged=tuple(others),
            pictures=tuple(picture.jpeg for picture in record.pictures.best),
        )
