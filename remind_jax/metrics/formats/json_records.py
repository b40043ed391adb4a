"""What JSON files of tracks may hold: COCO-video and YouTube-VIS, TAO and CocoVID, BURST.

One record covers all of them: which fields a file has says what it is.
"""

from __future__ import annotations

from typing import Annotated

import msgspec
from msgspec import Meta

from remind_jax.files.records import MOST_ROWS, Label, Side, Text, Whole
from remind_jax.sources.coco_rows import Code, Polygon

MOST_FRAMES = 10_000_000  # of a video; memory is taken by their number
_MOST_CATEGORIES = 100_000
_COORDINATE = 1e9  # pixels; further away nothing is

Id = Whole | Label
Coordinate = Annotated[float, Meta(ge=-_COORDINATE, le=_COORDINATE)]
Sides = Annotated[list[Coordinate], Meta(max_length=4)]  # left, top, width, height, or nothing
Outline = Annotated[list[Polygon], Meta(max_length=10_000)]
Shape = Code | str | Outline
Names = Annotated[tuple[Text, ...], Meta(max_length=MOST_FRAMES)]
_Categories = Annotated[list[Whole], Meta(max_length=_MOST_CATEGORIES)]
_Size = Annotated[int, Meta(ge=0, le=1 << 16)]  # 0: unknown


class Labeling(msgspec.Struct, frozen=True):
    """What a video says of its labels."""

    neg_category_ids: _Categories | None = None
    not_exhaustive_category_ids: _Categories | None = None


class MergedRecord(msgspec.Struct, frozen=True):
    """A category that is evaluated as another one."""

    id: Whole


class CategoryRecord(msgspec.Struct, frozen=True):
    """A class."""

    id: Whole
    name: Id | None = None
    merged: Annotated[list[MergedRecord], Meta(max_length=_MOST_CATEGORIES)] | None = None


class VideoRecord(Labeling, frozen=True, kw_only=True):
    """A scene."""

    id: Id
    name: Text | Whole | None = None
    file_names: Names | None = None
    length: Annotated[int, Meta(ge=0, le=MOST_FRAMES)] | None = None
    height: _Size | None = None
    width: _Size | None = None


class ImageRecord(msgspec.Struct, frozen=True):
    """A frame of TAO or CocoVID."""

    id: Id
    video_id: Id | None = None
    file_name: Text | None = None
    frame_index: Whole | None = None
    frame_id: Whole | None = None


class Entry(msgspec.Struct, frozen=True):
    """An annotation: a track with a shape per frame, or an object in an image."""

    id: Whole | None = None
    video_id: Id | None = None
    image_id: Id | None = None
    category_id: Whole | None = None
    track_id: Whole | None = None
    instance_id: Whole | None = None
    segmentations: Annotated[list[Shape | None], Meta(max_length=MOST_FRAMES)] | None = None
    bboxes: Annotated[list[Sides | None], Meta(max_length=MOST_FRAMES)] | None = None
    segmentation: Shape | None = None
    bbox: Sides | None = None
    score: float | None = None


class BurstEntry(msgspec.Struct, frozen=True):
    """A mask of BURST with its class."""

    rle: Code | str | None = None
    category_id: Whole | None = None


class SequenceRecord(Labeling, frozen=True, kw_only=True):
    """A scene of BURST."""

    height: Side
    width: Side
    dataset: Text | None = None
    seq_name: Text | None = None
    annotated_image_paths: Names | None = None
    track_category_ids: dict[Whole, Whole] | None = None
    segmentations: Annotated[
        list[dict[Whole, BurstEntry | str | None]], Meta(max_length=MOST_FRAMES)
    ] = []


class TrackFile(msgspec.Struct, frozen=True):
    """Everything but a list of results."""

    videos: Annotated[list[VideoRecord], Meta(max_length=MOST_ROWS)] | None = None
    images: Annotated[list[ImageRecord], Meta(max_length=MOST_ROWS)] | None = None
    categories: Annotated[list[CategoryRecord], Meta(max_length=_MOST_CATEGORIES)] | None = None
    annotations: Annotated[list[Entry], Meta(max_length=MOST_ROWS)] | None = None
    sequences: Annotated[list[SequenceRecord], Meta(max_length=MOST_ROWS)] | None = None


Results = Annotated[list[Entry], Meta(max_length=MOST_ROWS)]
Content = TrackFile | Results
