"""Tracks in COCO JSON: `coco-video` (YouTube-VIS), one row per track; `coco-vid`, one per image.

Frames of a video are its `file_names` or `length`, else its images in the order of `frame_index` or
`frame_id`. Lists of results name videos, images and categories by number only: those of the truth.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping, Sequence
from functools import cached_property
from typing import Any, Literal

import numpy as np

from remind_jax.errors import SourceError
from remind_jax.files.records import decode_rows
from remind_jax.formats.coco import (
    Annotation,
    Box,
    DataSet,
    ImageRecord,
    Segmentation,
    name_categories,
    say_bad,
    to_rle,
)
from remind_jax.formats.firm import firm_rows
from remind_jax.formats.rows import UNKNOWN_CLASS, RowCollector, TrackRows
from remind_jax.frame import Rle
from remind_jax.tracks import Tracks

CocoFormat = Literal["coco-video", "coco-vid"]


@dataclasses.dataclass(frozen=True)
class Video:
    """One scene of a file."""

    name: str
    num_frames: int
    frame_names: tuple[str, ...] | None
    size: tuple[int, int] | None  # height, width in pixels


@dataclasses.dataclass(frozen=True)
class CocoIndex:
    """Numbers of a file and what they stand for."""

    videos: Mapping[Any, Video] = dataclasses.field(default_factory=dict)  # by video id
    images: Mapping[Any, tuple[Any, int]] = dataclasses.field(default_factory=dict)  # video, place
    categories: Mapping[int, str] = dataclasses.field(default_factory=dict)

    @cached_property
    def class_names(self) -> tuple[str, ...]:
        """Names of the categories, by their number."""
        return tuple(self.categories[number] for number in sorted(self.categories))

    @cached_property
    def places(self) -> Mapping[int, int]:
        """Place of each category in `class_names`."""
        return {number: place for place, number in enumerate(sorted(self.categories))}


def index_videos(content: DataSet, file: str) -> CocoIndex:
    """Reads videos, images and categories of a truth file.

    Raises:
      SourceError: If its labels are federated: not every class is labeled in every video.
    """
    images_of: dict[Any, list[ImageRecord]] = {}
    for image in content.images:
        images_of.setdefault(image.video_id, []).append(image)
    places: dict[Any, tuple[Any, int]] = {}
    videos: dict[Any, Video] = {}
    for video in content.videos:
        if video.neg_category_ids is not None:
            raise SourceError(
                f"'{file}' is federated truth (`neg_category_ids`, as of TAO), which leaves "
                "objects unlabeled; score it by TrackEval, or take these fields out to count all"
            )
        images = sorted(images_of.get(video.id, ()), key=_frame_number)
        places |= {image.id: (video.id, place) for place, image in enumerate(images)}
        names = video.file_names or tuple(i.file_name for i in images if i.file_name is not None)
        length = len(names) if video.length is None else video.length
        length = len(images) if images else length
        common = names[0].rpartition("/")[0] if names else ""
        videos[video.id] = Video(
            name=str(video.name or common or video.id),
            num_frames=length,
            frame_names=names if names and len(names) == length else None,
            size=(video.height, video.width) if video.height and video.width else None,
        )
    return CocoIndex(videos, places, name_categories(content.categories, file))


def group_by_video(
    content: DataSet, format: CocoFormat, index: CocoIndex, file: str
) -> dict[Any, list[tuple[int, Annotation]]]:
    """Numbers and annotations of each video, by its id; those on unknown images are left out.

    Raises:
      SourceError: If an annotation is malformed.
    """
    groups: dict[Any, list[tuple[int, Annotation]]] = {}
    for row in decode_rows(content.annotations, Annotation, f"'{file}'"):
        annotation = row.get()
        video_id = annotation.video_id
        if format == "coco-vid":
            video_id, _ = index.images.get(annotation.image_id, (None, 0))
        groups.setdefault(video_id, []).append((row.number, annotation))
    return groups


def recognize_coco(content: DataSet, file: str) -> CocoFormat | None:
    """What a file with annotations is; None if it has none.

    Raises:
      SourceError: If its annotations are of no tracks.
    """
    if not content.annotations:
        return None
    first = next(decode_rows(content.annotations, Annotation, f"'{file}'")).get()
    if first.segmentations is not None or first.bboxes is not None:
        return "coco-video"
    if first.image_id is not None and (first.track_id, first.instance_id) != (None, None):
        return "coco-vid"
    raise SourceError(
        f"'{file}' is no JSON of tracks: COCO-video / YouTube-VIS ('segmentations' per track) or "
        "CocoVID ('image_id' and 'track_id')"
    )


def read_video(
    entries: Sequence[tuple[int, Annotation]],
    format: CocoFormat,
    index: CocoIndex,
    video_id: Any,
    file: str,
) -> TrackRows:
    """Reads the tracks of one video from its entries, see `group_by_video`.

    `index` is that of the file, or of the truth for a list of results.

    Raises:
      SourceError: If an entry is incomplete or malformed.
    """
    video = index.videos[video_id]
    rows = RowCollector()
    read = _read_track if format == "coco-video" else _read_annotation
    for number, entry in entries:
        class_id = index.places.get(entry.category_id, UNKNOWN_CLASS)  # pyright: ignore
        where = f"'{file}', row {number}"
        for frame, track_id, shape in read(entry, number, video, index, where):
            if isinstance(shape, tuple):
                left, top, width, height = shape
                box = [left, top, left + width, top + height]
                rows.add(frame, track_id, class_id, box=box)
            else:
                rows.add(frame, track_id, class_id, rle=_to_rle(shape, video.size, where))
    return rows.finish(
        video.name,
        video.num_frames,
        class_names=index.class_names,
        frame_names=video.frame_names,
        frame_size=video.size,
    )


_Row = tuple[int, int, Segmentation | Box]  # frame, id, shape


def _read_track(
    track: Annotation, number: int, video: Video, index: CocoIndex, where: str
) -> Iterator[_Row]:
    """Rows of a track; one of a list of results goes by its number in the list."""
    track_id = number if track.id is None else track.id
    shapes = track.bboxes if track.segmentations is None else track.segmentations
    if shapes is None:
        raise SourceError(f"{where} has neither 'segmentations' nor 'bboxes'")
    if len(shapes) > video.num_frames:
        raise SourceError(
            f"{where} has {len(shapes)} frames, its video '{video.name}' {video.num_frames}"
        )
    kind: Any = Box | None if track.segmentations is None else Segmentation | str | None
    empty = (b"null", b"[]")
    for frame, raw in enumerate(shapes):
        if bytes(raw) not in empty:
            shape = next(decode_rows([raw], kind, f"{where}, frame {frame}")).get()
            yield frame, track_id, shape


def _read_annotation(
    entry: Annotation, number: int, video: Video, index: CocoIndex, where: str
) -> Iterator[_Row]:
    """The row of an annotation of an image."""
    track_id = entry.instance_id if entry.track_id is None else entry.track_id
    shape = entry.segmentation or entry.bbox
    if track_id is None or shape is None:
        what = "'track_id'" if track_id is None else "'bbox' or 'segmentation'"
        raise SourceError(f"{where}: an annotation has no {what}")
    yield index.images[entry.image_id][1], track_id, shape


def _to_rle(shape: Any, size: tuple[int, int] | None, where: str) -> Rle:
    """A segmentation as a code; a bare text is one of the size of its video."""
    if isinstance(shape, str) and size is not None:
        return {"size": list(size), "counts": shape.encode("utf-8", "replace")}
    if isinstance(shape, str):
        raise SourceError(f"{where}: a segmentation needs the height and width of its video")
    if why := say_bad(shape):
        raise SourceError(f"{where}: a segmentation is malformed, {why}")
    return to_rle(shape, size)


def _frame_number(image: ImageRecord) -> tuple[int, str]:
    number = image.frame_id if image.frame_index is None else image.frame_index
    return number or 0, image.file_name or ""


def coco_video(
    tracks: Sequence[Tracks], class_names: Sequence[str], name: str, fps: float
) -> dict[str, Any]:
    """A run in the layout of YouTube-VIS annotations: per identity one mask or null per frame.

    `score` of an annotation is its mean confidence.
    """
    numbers = {label: number for number, label in enumerate(class_names, start=1)}
    height, width = tracks[0].frame_size if tracks else (0, 0)
    annotations: dict[int, dict[str, Any]] = {}
    scores: dict[int, list[float]] = {}
    for position, frame in enumerate(tracks):
        for row in firm_rows(frame):
            object_id = int(frame.object_id[row])
            if object_id not in annotations:
                annotations[object_id] = _empty_annotation(object_id, len(tracks)) | {
                    "category_id": numbers[frame.labels[row]],
                    "height": height,
                    "width": width,
                }
            left, top, right, bottom = (float(side) for side in frame.boxes[row])
            rle = frame.rles[row]
            annotation = annotations[object_id]
            annotation["segmentations"][position] = {
                "size": list(rle["size"]),
                "counts": rle["counts"].decode("ascii"),
            }
            annotation["bboxes"][position] = [left, top, right - left, bottom - top]
            annotation["areas"][position] = int(frame.areas[row])
            scores.setdefault(object_id, []).append(float(frame.confidence[row]))
    video = {"id": 1, "name": name, "height": height, "width": width, "length": len(tracks)}
    return {
        "info": {"description": name, "fps": fps},
        "videos": [video | {"file_names": [frame.name for frame in tracks]}],
        "categories": [{"id": number, "name": label} for label, number in numbers.items()],
        "annotations": [
            annotations[object_id] | {"score": float(np.mean(scores[object_id]))}
            for object_id in sorted(annotations)
        ],
    }


def _empty_annotation(object_id: int, num_frames: int) -> dict[str, Any]:
    return {
        "id": object_id + 1,
        "video_id": 1,
        "iscrowd": 0,
        "segmentations": [None] * num_frames,
        "bboxes": [None] * num_frames,
        "areas": [None] * num_frames,
    }
