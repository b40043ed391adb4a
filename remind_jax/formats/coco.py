"""COCO JSON: results, data sets and videos, whose rows are checked one by one."""

from __future__ import annotations

from pathlib import PurePosixPath
from typing import Annotated, Any

import msgspec
import numpy as np
from hotcoco import mask as coco
from jaxtyping import UInt8
from msgspec import Meta

from remind_jax.errors import SourceError
from remind_jax.files import limits
from remind_jax.files.reading import wrong_encoding
from remind_jax.files.records import Count, Label, Share, Side, Text, Whole, check, decode_json
from remind_jax.frame import Rle
from remind_jax.masks.run_length import decode_mask, is_malformed

Id = Whole | Text
Name = Annotated[str, Meta(min_length=1, max_length=limits.MAX_LABEL)]
_Coordinate = Annotated[float, Meta(ge=-limits.MAX_COORDINATE_PX, le=limits.MAX_COORDINATE_PX)]
_Length = Annotated[float, Meta(ge=0, le=limits.MAX_COORDINATE_PX)]
_Size = Annotated[int, Meta(ge=0, le=limits.MAX_SIDE_PX)]  # 0: unknown
Box = tuple[_Coordinate, _Coordinate, _Length, _Length]  # left, top, width, height
Polygon = Annotated[list[_Coordinate], Meta(min_length=6, max_length=200_000)]  # x, y, x, y, ...


class Code(msgspec.Struct, frozen=True):
    """A run-length code."""

    size: tuple[Side, Side]  # height, width
    counts: str | list[Count]


Segmentation = Code | Annotated[list[Polygon], Meta(max_length=10_000)]


class Annotation(msgspec.Struct, frozen=True):
    """An object in an image, or a track with a shape per frame of a video."""

    id: Whole | None = None
    image_id: Id | None = None
    video_id: Id | None = None
    category_id: Whole | None = None
    instance_id: Whole | None = None
    segmentation: Segmentation | None = None
    bbox: Box | None = None
    segmentations: list[msgspec.Raw] | None = None
    bboxes: list[msgspec.Raw] | None = None


class Detection(Annotation, frozen=True):
    """An annotation that a detector made."""

    label: Name | None = None
    score: Share = 1.0


class Category(msgspec.Struct, frozen=True):
    """A class."""

    id: Whole
    name: Name | Whole | None = None


class ImageRecord(msgspec.Struct, frozen=True):
    """A frame."""

    id: Id
    file_name: Text | None = None
    height: int | float | str | None = None  # some write "480" or 480.0
    width: int | float | str | None = None


class VideoRecord(msgspec.Struct, frozen=True):
    """A scene."""

    id: Id
    name: Text | Whole | None = None
    file_names: tuple[Text, ...] | None = None
    frame_numbers: tuple[Count, ...] = ()  # in the source, as `remind run` tells them
    length: Annotated[int, Meta(ge=0, le=limits.MAX_FRAMES)] | None = None
    height: _Size | None = None
    width: _Size | None = None
    neg_category_ids: msgspec.Raw | None = None  # of federated truth


class DataSet(msgspec.Struct, frozen=True):
    """A file; a list of results has annotations only."""

    annotations: list[msgspec.Raw]
    images: list[ImageRecord] = []
    videos: list[VideoRecord] = []
    categories: list[Category] = []


def read_data_set(data: bytes, file: str) -> DataSet:
    """What a file holds, its annotations still undecoded.

    Args:
      data: Content of the file: a mapping, a list of annotations, or one per line (`.jsonl`).

    Raises:
      SourceError: If it is something else.
    """
    if PurePosixPath(file).suffix.lower() == ".jsonl":
        if wrong := wrong_encoding(data):
            raise SourceError(f"'{file}': {wrong}")
        lines = data.removeprefix(b"\xef\xbb\xbf").splitlines()
        return DataSet([msgspec.Raw(line) for line in lines if line.strip()])
    if data.lstrip(b"\xef\xbb\xbf \t\r\n")[:1] == b"[":
        return DataSet(decode_json(data, list[msgspec.Raw], f"'{file}'"))
    return decode_json(data, DataSet, f"'{file}'")


def name_categories(categories: list[Category], file: str) -> dict[int, str]:
    """Name per category id, which stands for a missing name.

    Raises:
      SourceError: If one id has two names.
    """
    names: dict[int, str] = {}
    for category in categories:
        name = str(category.id if category.name is None else category.name)
        if names.setdefault(category.id, name) != name:
            raise SourceError(
                f"'{file}', `categories`: id {category.id} is both {names[category.id]!r} and "
                f"{name!r}; give every category an id of its own"
            )
    return names


def read_categories(data: bytes, file: str) -> dict[int, str]:
    """Category names: `{"categories": [{"id", "name"}]}`, `{"0": "cup"}`, or a list of names.

    Raises:
      SourceError: If it is something else.
    """

    class Named(msgspec.Struct):
        name: Name

    class Categories(msgspec.Struct):
        categories: list[Category] | None = None

    where = f"'{file}', names of categories"
    if data.lstrip(b"\xef\xbb\xbf \t\r\n")[:1] == b"[":
        listed = decode_json(data, list[Name | Named], where)
        return {i: c if isinstance(c, str) else c.name for i, c in enumerate(listed)}
    found = decode_json(data, Categories, where).categories
    if found is not None:
        return name_categories(found, file)
    return decode_json(data, dict[Whole, Label], where)


def to_rle(segmentation: Segmentation, frame_size: tuple[int, int] | None) -> Rle:
    """A segmentation as compressed run-length code.

    Raises:
      SourceError: If the size is needed and not known.
    """
    if isinstance(segmentation, list):
        if frame_size is None:
            raise SourceError("polygons need the height and width of their frame; give masks")
        return coco.merge(coco.frPyObjects(segmentation, *frame_size))
    if isinstance(segmentation.counts, str):
        return as_rle(segmentation)
    plain = {"size": list(segmentation.size), "counts": segmentation.counts}
    return coco.frPyObjects(plain, *segmentation.size)


def as_rle(code: Code) -> Rle:
    """A compressed code as the library takes it."""
    assert isinstance(code.counts, str)
    return {"size": list(code.size), "counts": code.counts.encode("utf-8", "replace")}


def decode_segmentation(segmentation: Any, frame_size: tuple[int, int]) -> UInt8[np.ndarray, "_ _"]:
    """The pixels of a segmentation that came in memory, 1 inside; codes are of their own size.

    Raises:
      SourceError: If it is malformed.
    """
    kind: Any = Segmentation
    checked = check(segmentation, kind, "a segmentation")
    if why := say_bad(checked):
        raise SourceError(f"a segmentation: {why}")
    return decode_mask(to_rle(checked, frame_size))


def say_bad(segmentation: Segmentation) -> str:
    """What is wrong with a segmentation; nothing if it is sound."""
    if isinstance(segmentation, list):
        return _say_bad_outline(segmentation)
    height, width = segmentation.size
    if height * width > limits.MAX_MASK_PIXELS:
        most = limits.MAX_MASK_PIXELS
        return f"its run-length code claims {width}x{height} pixels, at most {most} are read"
    if isinstance(segmentation.counts, str):
        is_bad = is_malformed(as_rle(segmentation))
    else:
        is_bad = sum(segmentation.counts) != height * width
    if is_bad:
        return f"its run-length code is damaged or does not add up to its size of {width}x{height}"
    return ""


def _say_bad_outline(polygons: list[list[float]]) -> str:
    length_px = 0.0
    for polygon in polygons:
        if len(polygon) % 2:
            return "a polygon is not a list of three or more points x, y"
        corners = np.array(polygon).reshape(-1, 2)
        length_px += float(np.abs(np.diff(corners, axis=0, append=corners[:1])).max(axis=1).sum())
    if length_px > limits.MAX_OUTLINE_PX:
        most = limits.MAX_OUTLINE_PX
        return f"its outline is {length_px:.0f} pixels long, at most {most:.0f} are read"
    return ""
