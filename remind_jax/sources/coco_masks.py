"""Detections in files, as COCO run-length codes.

Recognized:
    a COCO results list: [{"image_id", "category_id", "segmentation", "score"}, ...]
    a COCO data set: {"images": [...], "annotations": [...], "categories": [...]}
    a COCO video (YouTube-VIS): annotations with "segmentations", one per frame, null where unseen
    frames: [{"frame": 12, "detections": [...]}, ...], also one per line (.jsonl); "name" of the
        image file may stand in for the number
A detection has "segmentation" (run-length code, or polygons) or else "bbox" (left, top, width,
height), which is filled; "score"; "label", or "category_id" and categories to name it by.

An image of a COCO file belongs to the frame with the stem of its `file_name`; without that, to the
frame whose name has its `image_id` as number; in a video, to the frame of that number. The entries
of "segmentations" belong to the frames at the same place, or to the `file_names` of their video.
"""

from __future__ import annotations

import dataclasses
import json
from collections import defaultdict
from collections.abc import Iterable, Mapping
from pathlib import PurePosixPath
from typing import Any

import cv2
import numpy as np
from hotcoco import mask as coco
from jaxtyping import Bool

from remind_jax.errors import SourceError
from remind_jax.frame import NO_INSTANCE, Detections
from remind_jax.masks.run_length import find_malformed
from remind_jax.sources.class_names import ANY_CLASS
from remind_jax.sources.detections import detections_from, fill_boxes, name_classes
from remind_jax.sources.file_tree import last_number
from remind_jax.sources.source import Entry, Reader, UnreadableFrame

MAX_COORDINATE_PX = 1e5  # memory goes by the length of an outline
Annotation = Mapping[str, Any]


@dataclasses.dataclass(frozen=True)
class Position:
    """A frame by its place in the sequence, whatever its name."""

    index: int


Place = int | str | Position  # a frame by its number, its file name or its place


class CocoMasks:
    """Detections of a sequence from a file.

    Args:
      data: Content of the file, JSON or JSON lines.
      file: Its name for messages.
      reader: The frames that they belong to.
      categories: Name per category id, where the file has none.

    Raises:
      SourceError: If the file is of no known form, belongs to other frames, or has unnamed
        categories.
    """

    def __init__(
        self,
        data: bytes,
        file: str,
        reader: Reader,
        categories: Mapping[int, str] | None = None,
    ) -> None:
        content = _parse(data, file)
        self._file = file
        own = {c["id"]: str(c["name"]) for c in _list_in(content, "categories")}
        self._categories = own or dict(categories or {})
        by_place = _group_by_frame(content, file)
        self._rows = _match_places(by_place, reader)
        if by_place and not self._rows:
            frames = reader.entry_names
            raise SourceError(
                f"no detection in '{file}' belongs to a frame of '{reader.name}' (first in the "
                f"file: '{next(iter(by_place))}', first frame: '{frames[0] if frames else 0}')"
            )
        self.notes: list[str] = []
        if len(self._rows) < len(by_place):
            self.notes.append(
                f"{len(by_place) - len(self._rows)} of {len(by_place)} images in '{file}' are not "
                f"frames of '{reader.name}'"
            )
        self._require_names()

    def detections_of(self, entry: Entry, frame_size: tuple[int, int]) -> Detections:
        """Detections of one frame, in the order of the file."""
        rows = self._rows.get(entry.source_index, [])
        if not rows:
            return Detections.empty(*frame_size)
        parts = {
            "masks": [self._decode(row, frame_size) for row in rows],
            "labels": [self._name(row) for row in rows],
            "scores": [float(row.get("score", 1.0)) for row in rows],
            "instance_ids": [int(row.get("instance_id", NO_INSTANCE)) for row in rows],
        }
        return detections_from(parts, frame_size)

    def _decode(self, row: Annotation, frame_size: tuple[int, int]) -> Bool[np.ndarray, "H W"]:
        segmentation = row.get("segmentation")
        if segmentation:
            return decode_segmentation(segmentation, frame_size)
        if "bbox" not in row:
            raise UnreadableFrame(f"a detection in '{self._file}' has no segmentation and no bbox")
        left, top, width, height = np.asarray(row["bbox"], float)
        return fill_boxes(np.array([[left, top, left + width, top + height]]), frame_size)[0]

    def _name(self, row: Annotation) -> str:
        if "label" in row:
            return str(row["label"])
        if "category_id" not in row:
            return ANY_CLASS
        return name_classes([row["category_id"]], self._categories or None)[0]

    def _require_names(self) -> None:
        """Names every category without a name before work starts."""
        if not self._categories:
            return
        rows = (row for rows in self._rows.values() for row in rows)
        used = {r["category_id"] for r in rows if "category_id" in r and "label" not in r}
        missing = sorted(used - set(self._categories))
        if missing:
            raise SourceError(
                f"categories {', '.join(map(str, missing))} in '{self._file}' have no name; add "
                "them to its 'categories' or give a file of categories as metadata"
            )


def decode_segmentation(segmentation: Any, frame_size: tuple[int, int]) -> Bool[np.ndarray, "H W"]:
    """Decodes a COCO segmentation: compressed or plain run-length code, or polygons.

    Raises:
      UnreadableFrame: If it is malformed.
    """
    try:
        if isinstance(segmentation, Mapping):
            return _decode_runs(segmentation)
        return _fill_polygons(segmentation, frame_size)
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        if isinstance(error, UnreadableFrame):
            raise
        raise UnreadableFrame(f"a segmentation is malformed ({error})") from error


def _decode_runs(code: Mapping[str, Any]) -> Bool[np.ndarray, "H W"]:
    height, width = (int(n) for n in code["size"])
    counts = code["counts"].encode() if isinstance(code["counts"], str) else code["counts"]
    rle: Any = {"size": [height, width], "counts": counts}
    if isinstance(counts, list):
        rle = coco.frPyObjects(rle, height, width)
    if find_malformed([rle]) is not None:
        raise UnreadableFrame(f"a run-length code does not add up to its size of {width}x{height}")
    return _decode(rle)


def _fill_polygons(polygons: Any, frame_size: tuple[int, int]) -> Bool[np.ndarray, "H W"]:
    parts = [np.asarray(polygon, np.float64) for polygon in polygons]
    for part in parts:
        if part.ndim != 1 or len(part) < 6 or len(part) % 2:
            raise UnreadableFrame("a polygon is not a list of three or more points x, y")
        if not (np.abs(part) <= MAX_COORDINATE_PX).all():
            raise UnreadableFrame("a polygon leads to infinity")
    rles = coco.frPyObjects([part.tolist() for part in parts], *frame_size)
    return _decode(coco.merge(rles))


def _decode(rle: Any) -> Bool[np.ndarray, "H W"]:
    """Decodes by columns, as COCO stores them, and turns that into rows where OpenCV is quick."""
    return cv2.transpose(coco.decode(rle).T).astype(bool)


def read_categories(data: bytes, file: str) -> dict[int, str]:
    """Category names: `{"categories": [{"id", "name"}]}`, `{"0": "cup"}`, or a list of names.

    Raises:
      SourceError: If it is something else.
    """
    content = _parse(data, file)
    try:
        if isinstance(content, list):
            return {i: c if isinstance(c, str) else c["name"] for i, c in enumerate(content)}
        if "categories" in content:
            return {int(c["id"]): str(c["name"]) for c in content["categories"]}
        return {int(key): str(name) for key, name in content.items()}
    except (KeyError, TypeError, ValueError) as error:
        raise SourceError(
            f'\'{file}\' names no categories; give {{"categories": [{{"id": 1, "name": "cup"}}]}}'
        ) from error


def _parse(data: bytes, file: str) -> Any:
    try:
        if PurePosixPath(file).suffix.lower() == ".jsonl":
            return [json.loads(line) for line in data.splitlines() if line.strip()]
        return json.loads(data)
    except (ValueError, RecursionError) as error:
        raise SourceError(f"'{file}' is not valid JSON: {error}") from error


def _list_in(content: Any, key: str) -> list[Any]:
    value = content.get(key) if isinstance(content, Mapping) else None
    return value if isinstance(value, list) else []


def _group_by_frame(content: Any, file: str) -> dict[Place, list[Annotation]]:
    """Annotations by frame number or name, in the order of the file."""
    rows = content if isinstance(content, list) else _list_in(content, "annotations")
    is_known = isinstance(content, list) or "annotations" in content
    if not is_known or not all(isinstance(row, Mapping) for row in rows):
        raise SourceError(
            f"'{file}' holds no detections in a known form; give a COCO results list, a COCO data "
            'set, or [{"frame": 0, "detections": [...]}, ...]'
        )
    try:
        if rows and "detections" in rows[0]:
            return {
                r["name"] if "frame" not in r else int(r["frame"]): r["detections"] for r in rows
            }
        if rows and "segmentations" in rows[0]:
            return _unroll_videos(content, rows)
        files = {i["id"]: i["file_name"] for i in _list_in(content, "images") if "file_name" in i}
        grouped: dict[Place, list[Annotation]] = defaultdict(list)
        for row in rows:
            grouped[files.get(row["image_id"], row["image_id"])].append(row)
        return dict(grouped)
    except (KeyError, TypeError, ValueError) as error:
        raise SourceError(f"an entry of '{file}' is incomplete: {error!r} is missing") from error


def _unroll_videos(content: Any, rows: Iterable[Annotation]) -> dict[Place, list[Annotation]]:
    videos = {v["id"]: v.get("file_names") for v in _list_in(content, "videos")}
    grouped: dict[Place, list[Annotation]] = defaultdict(list)
    for row in rows:
        names = videos.get(row.get("video_id"))
        for index, segmentation in enumerate(row["segmentations"]):
            if segmentation:
                place = names[index] if names else Position(index)
                grouped[place].append(
                    {"instance_id": row["id"], **row, "segmentation": segmentation}
                )
    return dict(grouped)


def _match_places(
    by_place: Mapping[Place, list[Annotation]], reader: Reader
) -> dict[int, list[Annotation]]:
    """Annotations by source frame."""
    names = reader.entry_names or ()
    index_of: dict[Any, int] = {PurePosixPath(name).stem: i for i, name in enumerate(names)}
    for i, name in enumerate(names):
        number = last_number(name)
        index_of.setdefault(i if number is None else number, i)
    rows: dict[int, list[Annotation]] = defaultdict(list)
    for place, found in by_place.items():
        if isinstance(place, Position):
            index: int | None = place.index
        elif reader.entry_names is None:
            index = last_number(place) if isinstance(place, str) else place
        else:
            index = index_of.get(PurePosixPath(place).stem if isinstance(place, str) else place)
        if index is not None:
            rows[index].extend(found)
    return dict(rows)
