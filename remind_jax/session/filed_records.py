"""Records of objects in a memory file: what is kept of each, beside the bytes of its pictures."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from typing import Annotated

import msgspec
import numpy as np
from jaxtyping import UInt8
from msgspec import Meta

from remind_jax.errors import SourceError
from remind_jax.files.records import Count, Label, Positive, Small
from remind_jax.session.object_pictures import (
    MAX_FILE_BYTES,
    MAX_PICTURES,
    Picture,
    Pictures,
    best_of,
    fit_into,
)
from remind_jax.session.object_records import ObjectRecord, ObjectRecords, Sight

_JPEG_START = b"\xff\xd8\xff"


class _Row(msgspec.Struct, frozen=True):
    """A record in a file."""

    id: Count
    label: Label
    frames: Positive
    first: tuple[Positive, Small]
    last: tuple[Positive, Small]
    pictures: Annotated[
        list[tuple[Annotated[float, Meta(ge=0.0, le=1e9)], Positive]], Meta(max_length=MAX_PICTURES)
    ]  # quality and bytes of each
    visit: tuple[Count, Annotated[int, Meta(ge=-1, lt=MAX_PICTURES)]]  # its frames, its picture
    now: Count = 0  # frames in the session of the last sight
    lead: Count = 0  # of its class


class FiledRecords(msgspec.Struct, frozen=True):
    """What a memory file keeps of all records but the pictures."""

    session: Positive
    objects: Annotated[list[_Row], Meta(max_length=1_000_000)]
    names: Annotated[list[tuple[Count, Label]], Meta(max_length=1_000_000)]
    merged: Annotated[list[tuple[Count, Count]], Meta(max_length=1_000_000)]  # gone, kept
    gone: Annotated[list[Count], Meta(max_length=1_000_000)] = []  # objects of the parts before


def to_file(
    records: ObjectRecords, ids: Collection[int], since: Mapping[int, ObjectRecord] | None = None
) -> tuple[FiledRecords, UInt8[np.ndarray, "B"]]:
    """What a memory file keeps of the records, and the bytes of all pictures.

    Args:
      ids: Of objects that memory still has.
      since: Records that the file has already, as `kept` gave them; nothing if left out.
    """
    all_kept, before = records.kept(ids), since or {}
    kept = {one: new for one, new in all_kept.items() if before.get(one) is not new}
    recent = sorted(kept, key=lambda one: (kept[one].last, one), reverse=True)
    fitted = fit_into(MAX_FILE_BYTES, [kept[one].pictures.best for one in recent])
    fitting = dict(zip(recent, fitted, strict=True))
    rows = [
        _Row(
            id=one,
            label=record.label,
            frames=record.num_frames,
            first=(record.first.session, record.first.frame),
            last=(record.last.session, record.last.frame),
            pictures=[(picture.quality, len(picture.jpeg)) for picture in fitting[one]],
            visit=(record.pictures.num_frames, record.pictures.place_of_now(fitting[one])),
            now=record.num_now,
            lead=record.lead,
        )
        for one, record in kept.items()
    ]
    filed = FiledRecords(
        session=records.session,
        objects=rows,
        names=[(one, name) for one, name in records.given.items() if one in all_kept],
        merged=[
            (gone, target)
            for gone, target in records.merges.items()
            if gone in all_kept and target in all_kept
        ],
        gone=sorted(before.keys() - all_kept.keys()),
    )
    data = b"".join(picture.jpeg for one in kept for picture in fitting[one])
    return filed, np.frombuffer(data, np.uint8)


def from_file(parts: Sequence[tuple[FiledRecords, UInt8[np.ndarray, "_"]]]) -> ObjectRecords:
    """Reads back what `to_file` made: of everything first, then of what changed each time.

    Raises:
      SourceError: If its parts contradict each other; a phrase says how.
    """
    found: dict[int, ObjectRecord] = {}
    for filed, data in parts:
        for one in filed.gone:
            found.pop(one, None)
        found |= _read_rows(filed, data.tobytes())
    last = parts[-1][0]
    records = ObjectRecords(last.session, found)
    try:
        for object_id, name in last.names:
            records.restore_name(object_id, name)
        for gone, kept in last.merged:
            records.merge(kept, [gone])
    except SourceError as error:
        raise SourceError(f"its names and merges do not fit: {error}") from error
    return records


def _read_rows(filed: FiledRecords, pictures: bytes) -> dict[int, ObjectRecord]:
    """Records by id, with their pictures out of all that lie one after another."""
    found: dict[int, ObjectRecord] = {}
    start = 0
    for row in filed.objects:
        views = []
        for quality, length in row.pictures:
            jpeg = pictures[start : start + length]
            if len(jpeg) != length or not jpeg.startswith(_JPEG_START):
                raise SourceError(f"a picture of object {row.id} is no JPEG")
            views.append(Picture(quality, jpeg))
            start += length
        if row.id in found:
            raise SourceError(f"object {row.id} has two records")
        first, last = Sight(*row.first), Sight(*row.last)
        if not first <= last or last.session > filed.session:
            raise SourceError(f"object {row.id} was first seen after it was last seen")
        num_frames, place = row.visit
        now = views.pop(place) if 0 <= place < len(views) else None
        known = Pictures(best_of(views), now, num_frames)
        found[row.id] = ObjectRecord(row.label, row.frames, first, last, known, row.now, row.lead)
    if start != len(pictures):
        raise SourceError(f"{len(pictures) - start} bytes of pictures belong to no object")
    return found
