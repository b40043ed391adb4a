"""TAO and CocoVID JSON (one annotation per object and image) and BURST JSON (masks per frame).

Only annotated frames are evaluated. TAO and BURST truth is federated: not every class is labelled
in every video. A prediction on an unlabelled object counts as a false positive here; compare
identities (IDF1's recall, AssA, recovery) rather than precision on such data.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from remind_jax.errors import SourceError
from remind_jax.metrics.formats.json_index import JsonIndex, Video, to_box, to_rle
from remind_jax.metrics.formats.rows import UNKNOWN_CLASS, RowCollector, TrackRows


def read_tao(
    annotations: Sequence[Mapping[str, Any]], index: JsonIndex, video_id: Any, file: str
) -> TrackRows:
    """Reads the tracks of one video; predictions on images that the truth lacks are left out.

    Args:
      annotations: Of the whole file, with `track_id` (or `instance_id`), `image_id`, and `bbox` or
        `segmentation`.
      index: Of the file, or of the truth for a list of results.
      video_id: Which video.
      file: For messages.

    Raises:
      SourceError: If an annotation is incomplete or malformed.
    """
    video = index.videos[video_id]
    rows = RowCollector()
    has_masks = any(annotation.get("segmentation") for annotation in annotations)
    for annotation in annotations:
        of_video, frame = index.images.get(annotation.get("image_id"), (None, 0))
        if of_video != video_id:
            continue
        track_id = annotation.get("track_id", annotation.get("instance_id"))
        place = f"{file}, image {annotation.get('image_id')}"
        if track_id is None:
            raise SourceError(f"{place}: an annotation has no 'track_id'")
        class_id = index.class_index(annotation.get("category_id"), UNKNOWN_CLASS)
        if has_masks and annotation.get("segmentation"):
            rle = to_rle(annotation["segmentation"], video.size, place)
            rows.add(frame, int(track_id), class_id, rle=rle)
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
    )


def index_burst(content: Mapping[str, Any]) -> JsonIndex:
    """Videos (by place in `sequences`) and categories of a BURST file.

    Raises:
      SourceError: If a sequence has no list of annotated images.
    """
    videos: dict[Any, Video] = {}
    for place, sequence in enumerate(content["sequences"]):
        name = "/".join(str(sequence[k]) for k in ("dataset", "seq_name") if k in sequence)
        frames = sequence.get("annotated_image_paths")
        if frames is None:
            raise SourceError(f"BURST sequence '{name}' has no 'annotated_image_paths'")
        size = int(sequence["height"]), int(sequence["width"])
        videos[place] = Video(name, len(frames), tuple(frames), size)
    categories = {c["id"]: str(c.get("name", c["id"])) for c in content.get("categories") or ()}
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
            class_id = index.class_index(category_of.get(track_id), UNKNOWN_CLASS)
            rows.add(frame, int(track_id), class_id, rle=rle)
    return rows.finish(
        video.name,
        video.num_frames,
        class_names=index.class_names,
        frame_names=video.frame_names,
        frame_size=video.size,
    )
