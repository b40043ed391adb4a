"""Tracks in JSON of COCO-video (YouTube-VIS): one row per track, with a shape or null per frame.

Lists of results name videos and categories by number only: those of the truth.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping, Sequence
from functools import cached_property
from typing import Any

import numpy as np

from remind_jax.errors import SourceError
from remind_jax.files.records import decode_rows
from remind_jax.formats import coco
from remind_jax.formats.firm import firm_ids, firm_rows, main_labels, stated_confidence
from remind_jax.formats.rows import UNKNOWN_CLASS, Row, TrackRows, collect_rows
from remind_jax.frame import Rle
from remind_jax.tracks import Tracks


@dataclasses.dataclass(frozen=True)
class Video:
    """One scene of a file."""

    name: str
    num_frames: int
    frame_names: tuple[str, ...] | None
    size: tuple[int, int] | None  # height, width in pixels
    frame_numbers: tuple[int, ...] | None = None  # in the source, where they are said


@dataclasses.dataclass(frozen=True)
class CocoIndex:
    """Numbers of a file and what they stand for."""

    videos: Mapping[Any, Video] = dataclasses.field(default_factory=dict)  # by video id
    categories: Mapping[int, str] = dataclasses.field(default_factory=dict)

    @cached_property
    def class_names(self) -> tuple[str, ...]:
        """Names of the categories, by their number."""
        return tuple(self.categories[number] for number in sorted(self.categories))

    @cached_property
    def places(self) -> Mapping[int, int]:
        """Place of each category in `class_names`."""
        return {number: place for place, number in enumerate(sorted(self.categories))}


def index_videos(content: coco.DataSet, file: str) -> CocoIndex:
    """Reads videos and categories of a truth file.

    Raises:
      SourceError: If its labels are federated: not every class is labeled in every video; or if two
        videos have one id or name.
    """
    videos: dict[Any, Video] = {}
    known: set[str] = set()
    for video in content.videos:
        if video.neg_category_ids is not None:
            raise SourceError(
                f"'{file}' is federated truth (`neg_category_ids`, as of TAO), which leaves "
                "objects unlabeled; score it by TrackEval, or take these fields out to count all"
            )
        names = video.file_names or ()
        length = len(names) if video.length is None else video.length
        numbers = video.frame_numbers
        common = names[0].rpartition("/")[0] if names else ""
        name = str(video.name or common or video.id)
        if video.id in videos or name in known:
            raise SourceError(
                f"'{file}', `videos`: two have the id {video.id!r} or the name '{name}'; give each"
                " an id and a `name` of its own"
            )
        known.add(name)
        videos[video.id] = Video(
            name=name,
            num_frames=length,
            frame_names=names if names and len(names) == length else None,
            size=(video.height, video.width) if video.height and video.width else None,
            frame_numbers=numbers if numbers and len(numbers) == length else None,
        )
    return CocoIndex(videos, coco.name_categories(content.categories, file))


def group_by_video(
    content: coco.DataSet, file: str
) -> dict[Any, list[tuple[int, coco.Annotation]]]:
    """Numbers and annotations of each video, by its id.

    Raises:
      SourceError: If an annotation is malformed, or of no track.
    """
    groups: dict[Any, list[tuple[int, coco.Annotation]]] = {}
    for row in decode_rows(content.annotations, coco.Annotation, f"'{file}'"):
        annotation = row.get()
        if annotation.segmentations is None and annotation.bboxes is None:
            raise SourceError(
                f"'{file}', row {row.number} has neither 'segmentations' nor 'bboxes': it is of no "
                "track; give JSON of COCO-video / YouTube-VIS"
            )
        groups.setdefault(annotation.video_id, []).append((row.number, annotation))
    return groups


def read_video(
    entries: Sequence[tuple[int, coco.Annotation]], index: CocoIndex, video_id: Any, file: str
) -> TrackRows:
    """Reads the tracks of one video from its entries, see `group_by_video`.

    `index` is that of the file, or of the truth for a list of results.

    Raises:
      SourceError: If an entry is incomplete or malformed.
    """
    video = index.videos[video_id]
    rows: list[Row] = []
    for number, entry in entries:
        class_id = index.places.get(entry.category_id, UNKNOWN_CLASS)  # pyright: ignore
        track_id = number if entry.id is None else entry.id  # a list of results has no ids
        where = f"'{file}', row {number}"
        for frame, shape in _read_track(entry, video, where):
            if isinstance(shape, tuple):
                left, top, width, height = shape
                box = [left, top, left + width, top + height]
                rows.append((frame, track_id, class_id, None, box))
            else:
                rle = _to_rle(shape, video.size, where)
                rows.append((frame, track_id, class_id, rle, None))
    return collect_rows(
        video.name,
        video.num_frames,
        rows,
        class_names=index.class_names,
        frame_names=video.frame_names,
        frame_size=video.size,
        source_frames=None if video.frame_numbers is None else np.array(video.frame_numbers),
    )


def _read_track(
    track: coco.Annotation, video: Video, where: str
) -> Iterator[tuple[int, coco.Segmentation | coco.Box]]:
    """Frame and shape, wherever a track has one."""
    shapes = track.bboxes if track.segmentations is None else track.segmentations
    assert shapes is not None  # as `group_by_video` checked
    if len(shapes) != video.num_frames:
        raise SourceError(
            f"{where} has {len(shapes)} frames, its video '{video.name}' {video.num_frames}; give "
            "a shape for each frame, null where nothing is visible"
        )
    kind: Any = coco.Box if track.segmentations is None else coco.Segmentation | str
    for frame, raw in enumerate(shapes):
        if bytes(raw) not in (b"null", b"[]"):
            yield frame, next(decode_rows([raw], kind, f"{where}, frame {frame}")).get()


def _to_rle(shape: Any, size: tuple[int, int] | None, where: str) -> Rle:
    """A segmentation as a code; a bare text is one of the size of its video."""
    if isinstance(shape, str) and size is not None:
        return {"size": list(size), "counts": shape.encode("utf-8", "replace")}
    if isinstance(shape, str):
        raise SourceError(f"{where}: a segmentation needs the height and width of its video")
    if why := coco.say_bad(shape):
        raise SourceError(f"{where}: a segmentation is malformed, {why}")
    return coco.to_rle(shape, size)


def coco_video(
    tracks: Sequence[Tracks], class_names: Sequence[str], name: str, fps: float
) -> dict[str, Any]:
    """A run in the layout of YouTube-VIS annotations: per identity one mask or null per frame.

    The category of an annotation is that of most of its rows, `score` its mean confidence.
    """
    label_of = main_labels(tracks, [*map(firm_ids, tracks)])
    numbers = {label: number for number, label in enumerate(class_names, start=1)}
    height, width = tracks[0].frame_size if tracks else (0, 0)
    annotations: dict[int, dict[str, Any]] = {}
    scores: dict[int, list[float]] = {}
    for position, frame in enumerate(tracks):
        for row in firm_rows(frame):
            object_id = int(frame.object_id[row])
            if object_id not in annotations:
                annotations[object_id] = {
                    "id": object_id + 1,
                    "video_id": 1,
                    "iscrowd": 0,
                    "category_id": numbers[label_of[object_id]],
                    "height": height,
                    "width": width,
                    **{part: [None] * len(tracks) for part in ("segmentations", "bboxes", "areas")},
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
            scores.setdefault(object_id, []).append(stated_confidence(frame, row))
    video = {"id": 1, "name": name, "height": height, "width": width, "length": len(tracks)}
    return {
        "info": {"description": name, "fps": fps},
        "videos": [
            video
            | {
                "file_names": [frame.name for frame in tracks],
                "frame_numbers": [frame.source_index for frame in tracks],
            }
        ],
        "categories": [{"id": number, "name": label} for label, number in numbers.items()],
        "annotations": [
            annotations[object_id] | {"score": float(np.mean(scores[object_id]))}
            for object_id in sorted(annotations)
        ],
    }
