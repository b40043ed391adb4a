"""Rows of detections in JSON files, checked one by one: a bad row spoils no other.

Three forms are told apart: COCO results and data sets (one detection per row), COCO videos (one
object per row, a mask per frame), and frames (one frame per row, also one per line).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from pathlib import PurePosixPath
from typing import Annotated

import msgspec
import numpy as np
from msgspec import Meta

from remind_jax.errors import RemindError, SourceError
from remind_jax.files.reading import wrong_encoding
from remind_jax.files.records import (
    MOST_LABEL,
    Count,
    Share,
    Side,
    Small,
    Text,
    Whole,
    decode_json,
    decode_rows,
)
from remind_jax.frame import NO_INSTANCE, Rle
from remind_jax.masks.run_length import are_malformed

MOST_COORDINATE_PX = 1e5
MOST_OUTLINE_PX = 2e6  # memory of a library goes by the length of an outline
MOST_PIXELS = 1 << 26  # of a mask

Name = Annotated[str, Meta(min_length=1, max_length=MOST_LABEL)]
_Coordinate = Annotated[float, Meta(ge=-MOST_COORDINATE_PX, le=MOST_COORDINATE_PX)]
_Length = Annotated[float, Meta(ge=0, le=MOST_COORDINATE_PX)]
Box = tuple[_Coordinate, _Coordinate, _Length, _Length]  # left, top, width, height
Polygon = Annotated[list[_Coordinate], Meta(min_length=6, max_length=200_000)]  # x, y, x, y, ...


class Code(msgspec.Struct, frozen=True):
    """A run-length code."""

    size: tuple[Side, Side]  # height, width
    counts: str | list[Count]


Segmentation = Code | Annotated[list[Polygon], Meta(max_length=10_000)]


class Row(msgspec.Struct, frozen=True):
    """One detection."""

    image_id: Whole | Text | None = None
    category_id: Whole | None = None
    label: Name | None = None
    segmentation: Segmentation | None = None
    bbox: Box | None = None
    score: Share = 1.0
    instance_id: Small = NO_INSTANCE


class Category(msgspec.Struct, frozen=True):
    """A class of a COCO file."""

    id: Whole
    name: Name


class _Image(msgspec.Struct, frozen=True):
    id: Whole | Text
    file_name: Text | None = None


class _Video(msgspec.Struct, frozen=True):
    id: Whole | Text
    file_names: list[Text] | None = None


class _Track(msgspec.Struct, frozen=True):
    """One object of a COCO video."""

    id: Small
    segmentations: list[msgspec.Raw]
    video_id: Whole | Text | None = None
    category_id: Whole | None = None
    label: Name | None = None
    score: Share = 1.0


class _FrameRow(msgspec.Struct, frozen=True):
    detections: list[msgspec.Raw]
    frame: Count | None = None
    name: Text | None = None


class _DataSet(msgspec.Struct, frozen=True):
    annotations: list[msgspec.Raw]
    images: list[_Image] = []
    videos: list[_Video] = []
    categories: list[Category] = []


@dataclasses.dataclass(frozen=True)
class Position:
    """A frame by its place in the sequence, whatever its name."""

    index: int


Place = int | str | Position  # a frame by its number, its file name or its place


class FoundRows:
    """All detections of a file, by frame, in the order of the file; bad ones are left out.

    Args:
      data: Content of the file, JSON or JSON lines.
      file: Its name for messages.

    Attributes:
      by_place: Rows of each frame; a frame without good ones is there as well.
      categories: Name per category id, if the file has any.
      num_rows: Detections in the file.
      num_bad: Those of them that are left out.
      first_bad: What is wrong with the first of these.

    Raises:
      SourceError: If the file is of no known form, or not one of its rows is good.
    """

    def __init__(self, data: bytes, file: str) -> None:
        self._file = file
        self.by_place: dict[Place, list[Row]] = {}
        self.num_rows, self.num_bad = 0, 0
        self.first_bad: RemindError | None = None
        raws, rest = _read_rows(data, file)
        self.categories = name_categories(rest.categories, file)
        images = {image.id: image.file_name for image in rest.images if image.file_name}
        videos = {video.id: video.file_names for video in rest.videos}
        keys = _keys_of(raws)
        if "detections" in keys:
            self._add_frames(raws)
        elif "segmentations" in keys:
            self._add_tracks(raws, videos)
        else:
            self._add_detections(raws, images)
        self._drop_malformed()
        if self.num_bad and self.num_bad == self.num_rows:
            raise SourceError(
                f"'{file}': not one of {self.num_rows} detections can be used, the first: "
                f"{self.first_bad}"
            )

    def _add_detections(self, raws: list[msgspec.Raw], images: Mapping[int | str, str]) -> None:
        for row in decode_rows(raws, Row, f"'{self._file}'"):
            self.num_rows += 1
            if row.record is None:
                self._leave_out(row.error)
            elif row.record.image_id is None:
                self._refuse(f"row {row.number}: `image_id` is missing; add it")
            else:
                place = images.get(row.record.image_id, row.record.image_id)
                self.by_place.setdefault(place, []).append(row.record)

    def _add_frames(self, raws: list[msgspec.Raw]) -> None:
        for row in decode_rows(raws, _FrameRow, f"'{self._file}'"):
            if row.record is None:
                self.num_rows += 1
                self._leave_out(row.error)
                continue
            frame = row.record
            place = frame.name if frame.frame is None else frame.frame
            if place is None or place in self.by_place:
                why = "`frame` is missing; add it" if place is None else f"frame {place} is twice"
                raise SourceError(f"'{self._file}', row {row.number}: {why}")
            found = self.by_place.setdefault(place, [])
            where = f"'{self._file}', row {row.number}, `detections`"
            for detection in decode_rows(frame.detections, Row, where):
                self.num_rows += 1
                if detection.record is None:
                    self._leave_out(detection.error)
                else:
                    found.append(detection.record)

    def _add_tracks(
        self, raws: list[msgspec.Raw], videos: Mapping[int | str, list[str] | None]
    ) -> None:
        for row in decode_rows(raws, _Track, f"'{self._file}'"):
            if row.record is None:
                self.num_rows += 1
                self._leave_out(row.error)
                continue
            track = row.record
            names = videos.get(track.video_id) if track.video_id is not None else None
            where = f"'{self._file}', row {row.number}, `segmentations`"
            codes = decode_rows(track.segmentations, Segmentation | None, where)  # pyright: ignore[reportArgumentType]
            for index, code in enumerate(codes):
                if code.record is None and code.error is None:
                    continue
                self.num_rows += 1
                if names is not None and index >= len(names):
                    self._refuse(f"row {row.number}: it has more masks than its video has frames")
                elif code.error is not None:
                    self._leave_out(code.error)
                else:
                    place = names[index] if names else Position(index)
                    self.by_place.setdefault(place, []).append(
                        Row(
                            category_id=track.category_id,
                            label=track.label,
                            segmentation=code.record,
                            score=track.score,
                            instance_id=track.id,
                        )
                    )

    def _drop_malformed(self) -> None:
        """Leaves out rows whose masks are none, all codes looked at in one go."""
        rows = [(place, row) for place, found in self.by_place.items() for row in found]
        codes = [row.segmentation for _, row in rows]
        compressed = [code for code in codes if isinstance(code, Code) and _is_text(code)]
        rles: list[Rle] = [as_rle(code) for code in compressed]
        damaged = {id(c) for c, bad in zip(compressed, are_malformed(rles), strict=True) if bad}
        kept: dict[Place, list[Row]] = {place: [] for place in self.by_place}
        for place, row in rows:
            code = row.segmentation
            if not code:
                why = "" if row.bbox is not None else "it has neither `segmentation` nor `bbox`"
            elif isinstance(code, list):
                why = _say_bad_outline(code)
            else:
                why = _say_sum(code) if id(code) in damaged else _say_bad_size(code)
            if why:
                name = place.index if isinstance(place, Position) else place
                self._refuse(f"a detection of frame {name!r}: {why}")
            else:
                kept[place].append(row)
        self.by_place = kept

    def _refuse(self, why: str) -> None:
        self._leave_out(SourceError(f"'{self._file}', {why}"))

    def _leave_out(self, error: RemindError | None) -> None:
        self.num_bad += 1
        self.first_bad = self.first_bad or error


def as_rle(code: Code) -> Rle:
    """A compressed code as the library takes it."""
    assert isinstance(code.counts, str)
    return {"size": list(code.size), "counts": code.counts.encode()}


def name_categories(categories: list[Category], file: str) -> dict[int, str]:
    """Name per category id.

    Raises:
      SourceError: If one id has two names.
    """
    names: dict[int, str] = {}
    for category in categories:
        if names.setdefault(category.id, category.name) != category.name:
            raise SourceError(
                f"'{file}', `categories`: id {category.id} is both {names[category.id]!r} and "
                f"{category.name!r}; give every category an id of its own"
            )
    return names


def _read_rows(data: bytes, file: str) -> tuple[list[msgspec.Raw], _DataSet]:
    """The list of rows, still undecoded, and what else the file holds."""
    if PurePosixPath(file).suffix.lower() == ".jsonl":
        if wrong := wrong_encoding(data):
            raise SourceError(f"'{file}': {wrong}")
        lines = data.removeprefix(b"\xef\xbb\xbf").splitlines()
        raws = [msgspec.Raw(line) for line in lines if line.strip()]
        return raws, _DataSet(raws)
    if data.lstrip(b"\xef\xbb\xbf \t\r\n")[:1] == b"[":
        raws = decode_json(data, list[msgspec.Raw], f"'{file}'")
        return raws, _DataSet(raws)
    parts = decode_json(data, dict[str, msgspec.Raw], f"'{file}'")
    if "annotations" not in parts:
        raise SourceError(
            f"'{file}' holds no detections in a known form; give a COCO results list, a COCO data "
            'set, or [{"frame": 0, "detections": [...]}, ...]'
        )
    content = decode_json(data, _DataSet, f"'{file}'")
    return content.annotations, content


def _keys_of(raws: list[msgspec.Raw]) -> set[str]:
    """Fields of the first row that has any: all rows of a file are of one form."""
    for raw in raws:
        try:
            return set(msgspec.json.decode(raw, type=dict[str, msgspec.Raw]))
        except (msgspec.DecodeError, RecursionError):
            continue
    return set()


def say_bad_segmentation(segmentation: Segmentation) -> str:
    """What is wrong with a segmentation; nothing if it is sound."""
    if isinstance(segmentation, list):
        return _say_bad_outline(segmentation)
    if isinstance(segmentation.counts, str) and are_malformed([as_rle(segmentation)])[0]:
        return _say_sum(segmentation)
    return _say_bad_size(segmentation)


def _is_text(code: Code) -> bool:
    return isinstance(code.counts, str)


def _say_bad_size(code: Code) -> str:
    """What is wrong with the size of a code, or with plain run lengths; nothing if all is sound."""
    height, width = code.size
    if height * width > MOST_PIXELS:
        return f"its run-length code claims {width}x{height} pixels, at most {MOST_PIXELS} are read"
    is_short = isinstance(code.counts, list) and sum(code.counts) != height * width
    return _say_sum(code) if is_short else ""


def _say_sum(code: Code) -> str:
    height, width = code.size
    return f"its run-length code is damaged or does not add up to its size of {width}x{height}"


def _say_bad_outline(polygons: list[list[float]]) -> str:
    """What is wrong with polygons; nothing if they can be filled."""
    length_px = 0.0
    for polygon in polygons:
        if len(polygon) % 2:
            return "a polygon is not a list of three or more points x, y"
        corners = np.array(polygon).reshape(-1, 2)
        length_px += float(np.abs(np.diff(corners, axis=0, append=corners[:1])).max(axis=1).sum())
    if length_px > MOST_OUTLINE_PX:
        return f"its outline is {length_px:.0f} pixels long, at most {MOST_OUTLINE_PX:.0f} are read"
    return ""
