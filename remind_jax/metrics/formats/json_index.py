"""What JSON truth says about its videos, images and categories; result lists lean on it.

Result lists (of YouTube-VIS, of TAO) name videos, images and categories by number only.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Collection, Mapping, Sequence
from functools import cached_property
from typing import Any

from hotcoco import mask as coco

from remind_jax.errors import SourceError
from remind_jax.frame import Rle
from remind_jax.metrics.formats.json_records import ImageRecord, Labeling, Shape, TrackFile
from remind_jax.metrics.formats.rows import Federation
from remind_jax.sources.coco_rows import Code, say_bad_segmentation


@dataclasses.dataclass(frozen=True)
class Video:
    """One scene of a JSON file."""

    name: str
    num_frames: int
    frame_names: tuple[str, ...] | None
    size: tuple[int, int] | None  # height, width in pixels
    federation: Federation | None = None  # None: everything is labeled


@dataclasses.dataclass(frozen=True)
class JsonIndex:
    """Numbers of a JSON file and what they stand for."""

    videos: Mapping[Any, Video] = dataclasses.field(default_factory=dict)  # by video id
    images: Mapping[Any, tuple[Any, int]] = dataclasses.field(default_factory=dict)  # video, place
    categories: Mapping[int, str] = dataclasses.field(default_factory=dict)
    merged: Mapping[int, int] = dataclasses.field(default_factory=dict)  # category: evaluated as

    @cached_property
    def class_names(self) -> tuple[str, ...]:
        """Names of the categories, by their number."""
        return tuple(self.categories[number] for number in sorted(self.categories))

    def class_index(self, category_id: Any, unknown: int) -> int:
        """Place of a category in `class_names`, after merging."""
        return self._places.get(self.merged.get(category_id, category_id), unknown)

    @cached_property
    def _places(self) -> Mapping[int, int]:
        return place_categories(self.categories)


def index_json(content: TrackFile) -> JsonIndex:
    """Reads `videos`, `images` and `categories` of a truth file.

    Frames of a video are its `file_names` or `length` (YouTube-VIS), else its images in the order
    of `frame_index` (TAO) or `frame_id` (CocoVID).
    """
    categories = name_categories(content)
    images_of: dict[Any, list[ImageRecord]] = {}
    for image in content.images or ():
        images_of.setdefault(image.video_id, []).append(image)
    places: dict[Any, tuple[Any, int]] = {}
    videos: dict[Any, Video] = {}
    for video in content.videos or ():
        images = sorted(images_of.get(video.id, ()), key=_frame_number)
        places |= {image.id: (video.id, place) for place, image in enumerate(images)}
        names = video.file_names or tuple(i.file_name for i in images if i.file_name is not None)
        length = len(names) if video.length is None else video.length
        length = len(images) if images else length
        videos[video.id] = Video(
            name=str(video.name or _common_folder(names) or video.id),
            num_frames=length,
            frame_names=names if names and len(names) == length else None,
            size=(video.height, video.width) if video.height and video.width else None,
            federation=read_federation(video, categories),
        )
    merged = {
        part.id: category.id
        for category in content.categories or ()
        for part in category.merged or ()
    }
    return JsonIndex(videos, places, categories, merged)


def name_categories(content: TrackFile) -> dict[int, str]:
    """Names of the categories by their number, which stands for a missing name."""
    return {c.id: str(c.id if c.name is None else c.name) for c in content.categories or ()}


def read_federation(
    video: Labeling, categories: Mapping[int, str], unused: Collection[int] = ()
) -> Federation | None:
    """What a video's truth says of its labeling; None where it says nothing.

    `unused` are categories that are not evaluated.
    """
    said = (video.neg_category_ids, video.not_exhaustive_category_ids)
    if said == (None, None):
        return None
    places = place_categories(categories)
    absent, incomplete = (
        frozenset(places[number] for number in numbers or () if number in places)
        for numbers in said
    )
    return Federation(absent, incomplete, frozenset(places[n] for n in unused if n in places))


def place_categories(categories: Mapping[int, str]) -> dict[int, int]:
    """Place of each category in the order of their numbers."""
    return {number: place for place, number in enumerate(sorted(categories))}


def to_rle(shape: Shape, size: tuple[int, int] | None, place: str) -> Rle:
    """A COCO segmentation as compressed run-length code: code, plain counts or polygons.

    `size` (height, width) serves codes that do not tell it and polygons; `place` is for messages.

    Raises:
      SourceError: If it is malformed. Compressed codes are checked by `RowCollector.finish`.
    """
    if isinstance(shape, Code) and isinstance(shape.counts, str):
        return {"size": list(shape.size), "counts": _encode(shape.counts, place)}
    if isinstance(shape, Code):
        if wrong := say_bad_segmentation(shape):
            raise SourceError(f"{place}: a segmentation is malformed, {wrong}")
        return coco.frPyObjects({"size": list(shape.size), "counts": shape.counts}, *shape.size)
    if size is None:
        raise SourceError(f"{place}: a segmentation needs the height and width of its video")
    if isinstance(shape, str):
        return {"size": list(size), "counts": _encode(shape, place)}
    if wrong := say_bad_segmentation(shape):
        raise SourceError(f"{place}: a segmentation is malformed, {wrong}")
    return coco.merge(coco.frPyObjects(shape, *size))


def to_box(sides: Sequence[float], place: str) -> list[float]:
    """Left, top, right, bottom of a COCO box.

    Raises:
      SourceError: If it has other than four numbers.
    """
    if len(sides) != 4:
        raise SourceError(f"{place}: a box has {len(sides)} numbers; give left, top, width, height")
    left, top, width, height = sides
    return [left, top, left + width, top + height]


def _encode(counts: str, place: str) -> bytes:
    try:
        return counts.encode("ascii")
    except UnicodeEncodeError as error:
        raise SourceError(f"{place}: a segmentation is malformed, its code is no ASCII") from error


def _frame_number(image: ImageRecord) -> tuple[int, str]:
    number = image.frame_id if image.frame_index is None else image.frame_index
    return number or 0, image.file_name or ""


def _common_folder(names: Sequence[str]) -> str:
    return names[0].rpartition("/")[0] if names else ""
