"""Tracks in JSON: COCO-video and YouTube-VIS, TAO and CocoVID, BURST.

* `coco-video`: one annotation per track, one mask or box or null per frame. Predictions may be the
  list of results that YouTube-VIS asks for (`video_id`, `category_id`, `segmentations`), in
  which every entry is a track of its own.
* `tao`: one annotation per object and image; predictions may be a list of results.
* `burst`: masks per frame of every sequence.

Only annotated frames are evaluated. TAO and BURST truth is federated: not every class is labeled in
every video, and each video says which classes are known (`neg_category_ids`,
`not_exhaustive_category_ids`); `metrics.federated` takes that into account.
"""

from __future__ import annotations

import heapq
from collections.abc import Callable, Iterator, Sequence
from typing import Any, Literal

from remind_jax.errors import SourceError
from remind_jax.frame import Rle
from remind_jax.metrics.formats.json_index import (
    JsonIndex,
    Video,
    name_categories,
    read_federation,
    to_box,
    to_rle,
)
from remind_jax.metrics.formats.json_records import (
    BurstEntry,
    Content,
    SequenceRecord,
    TrackFile,
)
from remind_jax.metrics.formats.rows import UNKNOWN_CLASS, RowCollector, TrackRows

JsonFormat = Literal["coco-video", "tao", "burst"]

# Of a list of results for federated truth TAO takes the best-scored of an image.
MAX_DETECTIONS = 300

# Categories of BURST that only distract: neither evaluated nor ever wrong.
# fmt: off
BURST_DISTRACTORS = frozenset((
    20, 63, 108, 180, 188, 204, 212, 247, 303, 403, 407, 415, 490, 504, 507, 513, 529, 567, 569,
    588, 672, 691, 702, 708, 711, 720, 736, 737, 798, 813, 815, 827, 831, 851, 877, 883, 912, 971,
    976, 1130, 1133, 1134, 1169, 1184, 1220,
))
# fmt: on

Row = tuple[int, int, int | None, Rle | None, list[float] | None]  # frame, id, class, mask, box


def index_burst(content: TrackFile) -> JsonIndex:
    """Videos (by place in `sequences`) and categories of a BURST file.

    Raises:
      SourceError: If a sequence has no list of annotated images.
    """
    categories = name_categories(content)
    videos: dict[Any, Video] = {}
    for place, sequence in enumerate(content.sequences or ()):
        name = "/".join(part for part in (sequence.dataset, sequence.seq_name) if part is not None)
        frames = sequence.annotated_image_paths
        if frames is None:
            raise SourceError(f"BURST sequence '{name}' has no 'annotated_image_paths'")
        size = sequence.height, sequence.width
        federation = read_federation(sequence, categories, BURST_DISTRACTORS)
        videos[place] = Video(name, len(frames), frames, size, federation)
    return JsonIndex(videos, {}, categories)


def group_by_video(content: Content, format: JsonFormat, index: JsonIndex) -> dict[Any, list[Any]]:
    """What each video is made of, by its id; annotations on unknown images are left out.

    These are entries, each with its number in the file, or the sequence of BURST.
    """
    if isinstance(content, TrackFile) and format == "burst":
        return {place: [sequence] for place, sequence in enumerate(content.sequences or ())}
    groups: dict[Any, list[Any]] = {}
    annotations = content.annotations or () if isinstance(content, TrackFile) else content
    for number, annotation in enumerate(annotations, 1):
        if format == "tao":
            video_id, _ = index.images.get(annotation.image_id, (None, 0))
        else:
            video_id = annotation.video_id
        groups.setdefault(video_id, []).append((number, annotation))
    return groups


def read_video(
    entries: Sequence[Any],
    format: JsonFormat,
    index: JsonIndex,
    video_id: Any,
    file: str,
    *,
    is_results: bool = False,
) -> TrackRows:
    """Reads the tracks of one video from its entries, see `group_by_video`.

    `index` is that of the file, or of the truth for a list of results.

    Raises:
      SourceError: If an entry is incomplete or malformed.
    """
    video = index.videos[video_id]
    if format == "tao" and is_results and video.federation is not None:
        entries = _keep_best(entries)
    rows = RowCollector()
    for entry in entries:
        for frame, track_id, category, rle, box in _ROWS[format](entry, video, index, file):
            class_id = index.class_index(category, UNKNOWN_CLASS)
            rows.add(frame, track_id, class_id, rle=rle, box=box)
    return rows.finish(
        video.name,
        video.num_frames,
        class_names=index.class_names,
        frame_names=video.frame_names,
        frame_size=video.size,
        federation=video.federation,
    )


def _read_track(found: Any, video: Video, index: JsonIndex, file: str) -> Iterator[Row]:
    """Rows of a track of COCO-video; one of a list of results goes by its number in the list."""
    number, track = found
    track_id = number if track.id is None else track.id
    place = f"{file}, row {number}, track {track_id}"
    shapes = track.bboxes if track.segmentations is None else track.segmentations
    if shapes is None:
        raise SourceError(f"{place} has neither 'segmentations' nor 'bboxes'")
    if len(shapes) > video.num_frames:
        raise SourceError(
            f"{place} has {len(shapes)} frames, its video '{video.name}' {video.num_frames}"
        )
    for frame, shape in enumerate(shapes):
        if not shape:
            continue
        is_box = track.segmentations is None
        rle = None if is_box else to_rle(shape, video.size, place)
        box = to_box(shape, place) if is_box else None
        yield frame, track_id, track.category_id, rle, box


def _read_annotation(found: Any, video: Video, index: JsonIndex, file: str) -> Iterator[Row]:
    """The row of an annotation of TAO."""
    number, entry = found
    _, frame = index.images[entry.image_id]
    track_id = entry.instance_id if entry.track_id is None else entry.track_id
    place = f"{file}, row {number}, image {entry.image_id}"
    if track_id is None:
        raise SourceError(f"{place}: an annotation has no 'track_id'")
    if not entry.segmentation and entry.bbox is None:
        raise SourceError(f"{place}: an annotation has neither 'bbox' nor 'segmentation'")
    # TAO compares its boxes as they are written; its masks are only drawn from them.
    has_own_box = entry.bbox is not None and (
        not entry.segmentation or video.federation is not None
    )
    rle = to_rle(entry.segmentation, video.size, place) if entry.segmentation else None
    box = to_box(entry.bbox, place) if entry.bbox is not None and has_own_box else None
    yield frame, track_id, entry.category_id, rle, box


def _read_sequence(found: Any, video: Video, index: JsonIndex, file: str) -> Iterator[Row]:
    """Rows of a sequence of BURST."""
    sequence: SequenceRecord = found
    category_of = sequence.track_category_ids or {}
    for frame, tracks in enumerate(sequence.segmentations[: video.num_frames]):
        for track_id, entry in tracks.items():
            code = entry.rle if isinstance(entry, BurstEntry) else entry
            category = entry.category_id if isinstance(entry, BurstEntry) else None
            category = category_of.get(track_id) if category is None else category
            if code:
                rle = to_rle(code, video.size, f"{file}, {video.name}, frame {frame}")
                yield frame, track_id, category, rle, None


_ROWS: dict[JsonFormat, Callable[[Any, Video, JsonIndex, str], Iterator[Row]]] = {
    "coco-video": _read_track,
    "tao": _read_annotation,
    "burst": _read_sequence,
}


def _keep_best(found: Sequence[Any]) -> list[Any]:
    """The `MAX_DETECTIONS` best-scored annotations of every image, in their order."""
    of_image: dict[Any, list[int]] = {}
    for row, (_, annotation) in enumerate(found):
        of_image.setdefault(annotation.image_id, []).append(row)
    kept: list[int] = []
    for rows in of_image.values():
        kept += heapq.nlargest(MAX_DETECTIONS, rows, key=lambda row: found[row][1].score or 0.0)
    return [found[row] for row in sorted(kept)]
