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
from remind_jax.metrics.formats.rows import Federation


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


def index_json(content: Mapping[str, Any]) -> JsonIndex:
    """Reads `videos`, `images` and `categories` of a truth file.

    Frames of a video are its `file_names` or `length` (YouTube-VIS), else its images in the order
    of `frame_index` (TAO) or `frame_id` (CocoVID).
    """
    categories = {c["id"]: str(c.get("name", c["id"])) for c in content.get("categories") or ()}
    images_of: dict[Any, list[Mapping[str, Any]]] = {}
    for image in content.get("images") or ():
        images_of.setdefault(image.get("video_id"), []).append(image)
    places: dict[Any, tuple[Any, int]] = {}
    videos: dict[Any, Video] = {}
    for video in content["videos"]:
        images = sorted(images_of.get(video["id"], ()), key=_frame_number)
        places |= {image["id"]: (video["id"], place) for place, image in enumerate(images)}
        names = video.get("file_names") or [i["file_name"] for i in images if "file_name" in i]
        length = len(images) if images else int(video.get("length", len(names)))
        height, width = video.get("height"), video.get("width")
        videos[video["id"]] = Video(
            name=str(video.get("name") or _common_folder(names) or video["id"]),
            num_frames=length,
            frame_names=tuple(names) if names and len(names) == length else None,
            size=(int(height), int(width)) if height and width else None,
            federation=read_federation(video, categories),
        )
    merged = {
        part["id"]: category["id"]
        for category in content.get("categories") or ()
        for part in category.get("merged") or ()
    }
    return JsonIndex(videos, places, categories, merged)


def read_federation(
    video: Mapping[str, Any], categories: Mapping[int, str], unused: Collection[int] = ()
) -> Federation | None:
    """What a video's truth says of its labeling; None where it says nothing.

    `unused` are categories that are not evaluated.
    """
    keys = ("neg_category_ids", "not_exhaustive_category_ids")
    if not any(key in video for key in keys):
        return None
    places = place_categories(categories)
    absent, incomplete = (
        frozenset(places[number] for number in video.get(key) or () if number in places)
        for key in keys
    )
    return Federation(absent, incomplete, frozenset(places[n] for n in unused if n in places))


def place_categories(categories: Mapping[int, str]) -> dict[int, int]:
    """Place of each category in the order of their numbers."""
    return {number: place for place, number in enumerate(sorted(categories))}


def to_rle(segmentation: Any, size: tuple[int, int] | None, place: str) -> Rle:
    """A COCO segmentation as compressed run-length code: code, plain counts or polygons.

    `size` (height, width) serves codes that do not tell it and polygons; `place` is for messages.

    Raises:
      SourceError: If it is malformed.
    """
    try:
        if isinstance(segmentation, str | bytes):
            segmentation = {"size": _known(size), "counts": segmentation}
        if isinstance(segmentation, Mapping):
            height, width = (int(side) for side in segmentation["size"])
            counts = segmentation["counts"]
            if not isinstance(counts, list):
                text = counts.encode() if isinstance(counts, str) else bytes(counts)
                return {"size": [height, width], "counts": text}
            if sum(counts) != height * width or min(counts, default=0) < 0:
                raise ValueError("the counts do not add up to the size")
            return coco.frPyObjects({"size": [height, width], "counts": counts}, height, width)
        polygons = [[float(number) for number in polygon] for polygon in segmentation]
        if any(len(polygon) < 6 or len(polygon) % 2 for polygon in polygons) or not polygons:
            raise ValueError("a polygon has three or more points x, y")
        return coco.merge(coco.frPyObjects(polygons, *_known(size)))
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise SourceError(f"{place}: a segmentation is malformed ({error})") from error


def to_box(bbox: Sequence[float]) -> list[float]:
    """Left, top, right, bottom of a COCO box."""
    left, top, width, height = (float(number) for number in bbox)
    return [left, top, left + width, top + height]


def _known(size: tuple[int, int] | None) -> tuple[int, int]:
    if size is None:
        raise ValueError("its height and width are unknown")
    return size


def _frame_number(image: Mapping[str, Any]) -> tuple[int, str]:
    number = image.get("frame_index", image.get("frame_id", 0))
    return int(number), str(image.get("file_name", ""))


def _common_folder(names: Sequence[str]) -> str:
    return names[0].rpartition("/")[0] if names else ""
