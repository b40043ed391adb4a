"""Detections in files as COCO run-length codes; which frame a row belongs to: file_formats.md.

Rows that are damaged are left out, counted and told in `notes`.
"""

from __future__ import annotations

import contextlib
import dataclasses
import math
from collections.abc import Collection, Iterator, Mapping
from pathlib import PurePosixPath
from typing import Any

import msgspec
import numpy as np
from jaxtyping import Bool
from msgspec.structs import replace

from remind_jax.crops import require_room
from remind_jax.errors import SourceError
from remind_jax.files.limits import MAX_MASK_PIXELS
from remind_jax.files.records import Count, Text, decode_rows
from remind_jax.formats import coco
from remind_jax.frame import NO_INSTANCE, Detections, fill_boxes
from remind_jax.masks.run_length import decode_mask
from remind_jax.sources.class_names import UNNAMED_CLASS
from remind_jax.sources.file_tree import last_number
from remind_jax.sources.label_maps import fit_plane
from remind_jax.sources.source import Entry, Reader


@dataclasses.dataclass(frozen=True)
class _Position:
    """A frame by its place in the sequence, whatever its name."""

    index: int
    video_id: int | str | None

    def __str__(self) -> str:
        return str(self.index)


_Place = int | str | _Position  # a frame by its number, its file name or its place
# What the file says of a place: a detection, why it is none, or that the frame is there.
_Said = tuple[_Place, coco.Detection | str | None]


class _FrameRow(msgspec.Struct, frozen=True):
    detections: list[msgspec.Raw]
    frame: Count | None = None
    name: Text | None = None


class CocoMasks:
    """Detections of a sequence from a file.

    Raises:
      SourceError: If the file is of no known form, belongs to other frames, has unnamed
        categories, or not one good row.
    """

    def __init__(
        self, data: bytes, file: str, reader: Reader, categories: Mapping[int, str] | None
    ) -> None:
        self._file, self._num_rows = file, 0
        self._bad: dict[Any, str] = {}  # what is wrong, by row; sources are iterated several times
        content = coco.read_data_set(data, file)
        self._categories = coco.name_categories(content.categories, file) or dict(categories or {})
        by_place: dict[_Place, list[coco.Detection]] = {}
        self._size_of: dict[_Place, tuple[int, int]] = {}  # height, width, where the file tells
        # All rows of a file are of one form.
        raws = decode_rows(content.annotations, dict[str, msgspec.Raw], "")
        first = next((raw.record for raw in raws if raw.record is not None), {})
        if {"format", "info"} <= first.keys():
            raise SourceError(
                f"'{file}' is the record of a run, not masks; give coco_video.json beside it"
            )
        read = self._rows_of_frames if "detections" in first else self._rows_of_annotations
        for place, row in read(content):
            if row is None:
                by_place[place] = []
                continue
            self._num_rows += 1
            if isinstance(row, str):
                self._bad[self._num_rows] = row
            elif why := _say_bad_row(row):
                self._bad[self._num_rows] = f"a detection of frame '{place}': {why}"
            else:
                by_place.setdefault(place, []).append(row)
        if self._bad and len(self._bad) == self._num_rows:
            raise SourceError(
                f"'{file}': not one of {self._num_rows} detections can be used, the first: "
                f"{next(iter(self._bad.values()))}"
            )
        self._place_of = _match_places(by_place, reader, file)
        self._rows = {index: by_place[place] for index, place in self._place_of.items()}
        if by_place and not self._rows:
            frames = reader.entry_names
            raise SourceError(
                f"no detection in '{file}' belongs to a frame of '{reader.name}' (first in the "
                f"file: '{next(iter(by_place))}', first frame: '{frames[0] if frames else 0}')"
            )
        self.frames = self._rows.keys()
        self._unused_note = ""
        if len(self._rows) < len(by_place):
            self._unused_note = (
                f"{len(by_place) - len(self._rows)} of {len(by_place)} images in '{file}' are not "
                f"frames of '{reader.name}'"
            )
        self.notes: list[str] = []
        self._tell()
        self._require_names()

    def detections_of(self, entry: Entry, frame_size: tuple[int, int]) -> Detections:
        """Detections of one frame, in the order of the file.

        Raises:
          UnreadableFrame: If there are too many, or more than memory is meant for.
          SourceError: If none of their masks can be of this picture.
        """
        rows = self._rows.get(entry.source_index, [])
        require_room(len(rows), frame_size, f"'{self._file}'")
        size = self._size_of.get(self._place_of.get(entry.source_index, ""), frame_size)
        masks, kept = np.zeros((len(rows), *frame_size), bool), []
        unfit: SourceError | None = None
        for number, row in enumerate(rows):
            try:
                masks[len(kept)] = _mask_of(row, size, frame_size)
            except SourceError as error:
                unfit, said = error, f"a detection of frame {entry.source_index}: {error}"
                self._bad.setdefault((entry.source_index, number), said)
            else:
                kept.append(row)
        if unfit is not None:
            self._tell()
            if not kept:
                raise unfit
        return Detections.create(
            masks[: len(kept)],
            [self._label(row) for row in kept],
            [row.score for row in kept],
            [NO_INSTANCE if row.instance_id is None else row.instance_id for row in kept],
        )

    def _rows_of_annotations(self, content: coco.DataSet) -> Iterator[_Said]:
        images = {image.id: image for image in content.images}
        videos = {video.id: video for video in content.videos}
        for found in decode_rows(content.annotations, coco.Detection, f"'{self._file}'"):
            row = found.record
            if row is None:
                yield "", str(found.error)
            elif row.segmentations is not None:
                video = None if row.video_id is None else videos.get(row.video_id)
                where = f"'{self._file}', row {found.number}, `segmentations`"
                for place, shape in _rows_of_track(row, video and video.file_names, where):
                    self._note_size(place, video)
                    yield place, shape
            elif row.image_id is None:
                yield "", f"'{self._file}', row {found.number}: `image_id` is missing"
            else:
                image = images.get(row.image_id)
                place = (image and image.file_name) or row.image_id
                self._note_size(place, image)
                yield place, row

    def _note_size(
        self, place: _Place, picture: coco.ImageRecord | coco.VideoRecord | None
    ) -> None:
        given = () if picture is None else (picture.height, picture.width)
        with contextlib.suppress(ValueError, OverflowError):  # not known
            height, width = (int(float(side or 0)) for side in given)
            if min(height, width) > 0:
                self._size_of[place] = height, width

    def _rows_of_frames(self, content: coco.DataSet) -> Iterator[_Said]:
        places = set()
        for found in decode_rows(content.annotations, _FrameRow, f"'{self._file}'"):
            if (frame := found.record) is None:
                yield "", str(found.error)
                continue
            place = frame.name if frame.frame is None else frame.frame
            if place is None or place in places:
                why = "`frame` is missing" if place is None else f"frame {place} is there twice"
                raise SourceError(f"'{self._file}', row {found.number}: {why}")
            places.add(place)
            yield place, None
            where = f"'{self._file}', row {found.number}, `detections`"
            for row in decode_rows(frame.detections, coco.Detection, where):
                yield place, str(row.error) if row.record is None else row.record

    def _label(self, row: coco.Detection) -> str:
        if row.label is None and row.category_id is not None:
            return self._categories.get(row.category_id, str(row.category_id))
        return row.label or UNNAMED_CLASS

    def _tell(self) -> None:
        left_out = ""
        if self._bad:
            left_out = (
                f"{len(self._bad)} of {self._num_rows} detections of '{self._file}' are left out, "
                f"the first: {next(iter(self._bad.values()))}"
            )
        self.notes[:] = filter(None, (self._unused_note, left_out))

    def _require_names(self) -> None:
        """Names every category without a name before work starts."""
        rows = [row for rows in self._rows.values() for row in rows if row.label is None]
        used = {row.category_id for row in rows if row.category_id is not None}
        missing = sorted(used - set(self._categories)) if self._categories else []
        if missing:
            raise SourceError(
                f"categories {', '.join(map(str, missing[:20]))} in '{self._file}' have no name; "
                "add them to its 'categories' or give a file of categories as metadata"
            )


def _rows_of_track(
    track: coco.Detection, names: tuple[str, ...] | None, where: str
) -> Iterator[tuple[_Place, coco.Detection | str]]:
    """A row of each frame that has a mask."""
    kind: Any = coco.Segmentation | None
    for index, code in enumerate(decode_rows(track.segmentations or (), kind, where)):
        if code.error is not None:
            yield "", str(code.error)
        elif code.record is not None and names is not None and index >= len(names):
            yield "", f"{where}: there are more than its video has frames"
        elif code.record is not None:
            place = names[index] if names else _Position(index, track.video_id)
            changes: dict[str, Any] = {"segmentation": code.record, "instance_id": track.id}
            yield place, replace(track, segmentations=None, bboxes=None, bbox=None, **changes)


def _say_bad_row(row: coco.Detection) -> str:
    if row.segmentation:
        return coco.say_bad(row.segmentation)
    return "" if row.bbox is not None else "it has neither `segmentation` nor `bbox`"


def _mask_of(
    row: coco.Detection, size: tuple[int, int], frame_size: tuple[int, int]
) -> Bool[np.ndarray, "H W"]:
    """The mask in the frame; `size` is that of the picture that boxes and polygons are of."""
    is_shape = not row.segmentation or isinstance(row.segmentation, list)
    if is_shape and math.prod(size) > MAX_MASK_PIXELS:
        raise SourceError(
            f"its picture is {size[1]}x{size[0]} pixels, at most {MAX_MASK_PIXELS} are read; give "
            "masks of the frame's size"
        )
    if not row.segmentation:
        assert row.bbox is not None
        left, top, width, height = row.bbox
        mask = fill_boxes(np.array([[left, top, left + width, top + height]]), size)[0]
    else:
        mask = decode_mask(coco.to_rle(row.segmentation, size))
    return fit_plane(mask, frame_size, "a mask").view(bool)


def _match_places(places: Collection[_Place], reader: Reader, file: str) -> dict[int, _Place]:
    """Places by source frame; only those in a folder of the name of the source, if there are any.

    Raises:
      SourceError: If two are of one frame, or of several videos without names of frames.
    """
    videos = sorted({str(place.video_id) for place in places if isinstance(place, _Position)})
    if len(videos) > 1:
        raise SourceError(
            f"'{file}' has tracks of {len(videos)} videos without names of frames (`video_id` "
            f"{', '.join(videos[:4])}); leave those of one video"
        )
    own = [p for p in places if isinstance(p, str) and reader.name in PurePosixPath(p).parts[:-1]]
    names = reader.entry_names or ()
    index_of: dict[Any, int] = {PurePosixPath(name).stem: i for i, name in enumerate(names)}
    for i, name in enumerate(names):
        number = last_number(name)
        index_of.setdefault(i if number is None else number, i)
    place_of: dict[int, _Place] = {}
    for place in own or places:
        if isinstance(place, _Position):
            index: int | None = place.index
        elif reader.entry_names is None:
            index = last_number(place) if isinstance(place, str) else place
        else:
            index = index_of.get(PurePosixPath(place).stem if isinstance(place, str) else place)
        if index is not None and place_of.setdefault(index, place) != place:
            raise SourceError(
                f"'{file}': '{place_of[index]}' and '{place}' are both frame {index} of "
                f"'{reader.name}'; leave those of one video, or name the source after its folder "
                "in the file"
            )
    return place_of
