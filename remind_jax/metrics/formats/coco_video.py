"""COCO-video and YouTube-VIS JSON: one annotation per track, one mask or box or null per frame.

Truth has `videos`, `annotations` and `categories`; predictions have the same, or are the list of
results that YouTube-VIS asks for (`video_id`, `category_id`, `segmentations`, `score`), in which
every entry is a track of its own.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from remind_jax.errors import SourceError
from remind_jax.metrics.formats.json_index import JsonIndex, to_box, to_rle
from remind_jax.metrics.formats.rows import UNKNOWN_CLASS, RowCollector, TrackRows


def read_coco_video(
    annotations: Sequence[Mapping[str, Any]], index: JsonIndex, video_id: Any, file: str
) -> TrackRows:
    """Reads the tracks of one video.

    Args:
      annotations: Of the whole file.
      index: Of the file, or of the truth for a list of results.
      video_id: Which video.
      file: For messages.

    Raises:
      SourceError: If an annotation is incomplete or malformed, or longer than its video.
    """
    video = index.videos[video_id]
    rows = RowCollector()
    for number, annotation in enumerate(annotations, 1):
        if annotation.get("video_id") != video_id:
            continue
        track_id = int(annotation.get("id", number))
        place = f"{file}, track {track_id}"
        masks = annotation.get("segmentations")
        boxes = annotation.get("bboxes")
        entries = masks if masks is not None else boxes
        if entries is None:
            raise SourceError(f"{place} has neither 'segmentations' nor 'bboxes'")
        if len(entries) > video.num_frames:
            raise SourceError(
                f"{place} has {len(entries)} frames, its video '{video.name}' {video.num_frames}"
            )
        class_id = index.class_index(annotation.get("category_id"), UNKNOWN_CLASS)
        for frame, entry in enumerate(entries):
            if not entry:
                continue
            if masks is not None:
                rows.add(frame, track_id, class_id, rle=to_rle(entry, video.size, place))
            else:
                rows.add(frame, track_id, class_id, box=to_box(entry))
    return rows.finish(
        video.name,
        video.num_frames,
        class_names=index.class_names,
        frame_names=video.frame_names,
        frame_size=video.size,
        federation=video.federation,
    )
