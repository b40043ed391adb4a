"""TAO and CocoVID JSON (one annotation per object and image) and BURST JSON (masks per frame).

Only annotated frames are evaluated. TAO and BURST truth is federated: not every class is labelled
in every video, and each video says which classes are known (`neg_category_ids`,
`not_exhaustive_category_ids`); `metrics.federated` takes that into account.
"""

from __future__ import annotations

import heapq
from collections.abc import Mapping, Sequence
from typing import Any

from remind_jax.errors import SourceError
from remind_jax.metrics.formats.json_index import (
    JsonIndex,
    Video,
    read_federation,
    to_box,
    to_rle,
)
from remind_jax.metrics.formats.rows import UNKNOWN_CLASS, RowCollector, TrackRows

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


def group_by_video(
    annotations: Sequence[Mapping[str, Any]], index: JsonIndex
) -> dict[Any, list[Mapping[str, Any]]]:
    """Annotations of each video, by its id; those on unknown images are left out."""
    groups: dict[Any, list[Mapping[str, Any]]] = {}
    for annotation in annotations:
        video_id, _ = index.images.get(annotation.get("image_id"), (None, 0))
        groups.setdefault(video_id, []).append(annotation)
    return groups


def read_tao(
    annotations: Sequence[Mapping[str, Any]],
    index: JsonIndex,
    video_id: Any,
    file: str,
    *,
    is_results: bool = False,
) -> TrackRows:
    """Reads the tracks of one video.

    Args:
      annotations: Of the video, with `track_id` (or `instance_id`), `image_id`, and `bbox` or
        `segmentation`.
      index: Of the file, or of the truth for a list of results.
      video_id: Which video.
      file: For messages.
      is_results: Whether this is a list of results, with `score`.

    Raises:
      SourceError: If an annotation is incomplete or malformed.
    """
    video = index.videos[video_id]
    rows = RowCollector()
    if is_results and video.federation is not None:
        annotations = _keep_best(annotations)
    for annotation in annotations:
        _, frame = index.images[annotation.get("image_id")]
        track_id = annotation.get("track_id", annotation.get("instance_id"))
        place = f"{file}, image {annotation.get('image_id')}"
        if track_id is None:
            raise SourceError(f"{place}: an annotation has no 'track_id'")
        class_id = index.class_index(annotation.get("category_id"), UNKNOWN_CLASS)
        if annotation.get("segmentation"):
            rle = to_rle(annotation["segmentation"], video.size, place)
            # TAO compares its boxes as they are written; its masks are only drawn from them.
            has_own_box = video.federation is not None and "bbox" in annotation
            box = to_box(annotation["bbox"]) if has_own_box else None
            rows.add(frame, int(track_id), class_id, rle=rle, box=box)
        elif "bbox" in annotation:
            rows.add(frame, int(track_id), class_id, box=to_box(annotation["bbox"]))
        else:
            raise SourceError(f"{place}: an annotation has neither 'bbox' nor 'segmentation'")
    return rows.finish(
        video.name,
        video.num_frames,
        class_names=index.class_names,
        frame_names=video.frame_names,
        frame_size=video.size,
        federation=video.federation,
    )


def _keep_best(annotations: Sequence[Mapping[str, Any]]) -> list[Mapping[str, Any]]:
    """The `MAX_DETECTIONS` best-scored annotations of every image, in their order."""
    of_image: dict[Any, list[int]] = {}
    for row, annotation in enumerate(annotations):
        of_image.setdefault(annotation.get("image_id"), []).append(row)
    kept: list[int] = []
    for rows in of_image.values():
        kept += heapq.nlargest(
            MAX_DETECTIONS, rows, key=lambda row: float(annotations[row].get("score", 0.0))
        )
    return [annotations[row] for row in sorted(kept)]


def index_burst(content: Mapping[str, Any]) -> JsonIndex:
    """Videos (by place in `sequences`) and categories of a BURST file.

    Raises:
      SourceError: If a sequence has no list of annotated images.
    """
    categories = {c["id"]: str(c.get("name", c["id"])) for c in content.get("categories") or ()}
    videos: dict[Any, Video] = {}
    for place, sequence in enumerate(content["sequences"]):
        name = "/".join(str(sequence[k]) for k in ("dataset", "seq_name") if k in sequence)
        frames = sequence.get("annotated_image_paths")
        if frames is None:
            raise SourceError(f"BURST sequence '{name}' has no 'annotated_image_paths'")
        size = int(sequence["height"]), int(sequence["width"])
        federation = read_federation(sequence, categories, BURST_DISTRACTORS)
        videos[place] = Video(name, len(frames), tuple(frames), size, federation)
    return JsonIndex(videos, {}, categories)


def read_burst(sequence: Mapping[str, Any], index: JsonIndex, place: int, file: str) -> TrackRows:
    """Reads one sequence of a BURST file.

    Raises:
      SourceError: If a mask is malformed.
    """
    video = index.videos[place]
    category_of = sequence.get("track_category_ids") or {}
    rows = RowCollector()
    for frame, tracks in enumerate(sequence["segmentations"][: video.num_frames]):
        for track_id, entry in tracks.items():
            code = entry.get("rle") if isinstance(entry, Mapping) else entry
            if not code:
                continue
            rle = to_rle(code, video.size, f"{file}, {video.name}, frame {frame}")
            category = entry.get("category_id") if isinstance(entry, Mapping) else None
            category = category_of.get(track_id) if category is None else category
            class_id = index.class_index(category, UNKNOWN_CLASS)
            rows.add(frame, int(track_id), class_id, rle=rle)
    return rows.finish(
        video.name,
        video.num_frames,
        class_names=index.class_names,
        frame_names=video.frame_names,
        frame_size=video.size,
        federation=video.federation,
    )
