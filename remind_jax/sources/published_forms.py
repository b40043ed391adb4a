"""What detectors and libraries give, known by its attributes, so that none of them is imported."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from jaxtyping import Bool

from remind_jax.crops import require_room
from remind_jax.errors import SourceError
from remind_jax.files.host_array import host_array
from remind_jax.formats.coco import decode_segmentation
from remind_jax.frame import check_size
from remind_jax.masks.letterbox import Letterbox
from remind_jax.sources.label_maps import fit_plane
from remind_jax.sources.source import say_size

Parts = Mapping[str, Any]  # "masks" or "boxes", "labels" or "class_ids", "scores", "class_names"
_Planes = Bool[np.ndarray, "N H W"]


def published_parts(obj: Any, frame_size: tuple[int, int]) -> Parts | None:
    """The parts of detections in a published form; None if they are in no such form.

    A list of one answer is that answer: models answer a list of pictures.

    Raises:
      SourceError: If it holds answers for several pictures, belongs to another picture, or neither
        masks nor boxes.
    """
    items = obj if isinstance(obj, list | tuple) else ()
    if items and all(isinstance(item, Mapping) and "segmentation" in item for item in items):
        return _parts_of_sam(items, frame_size)
    if items and _read_by(next(iter(items))) is not None:
        if len(items) > 1:
            raise SourceError(
                f"the detector answered for {len(items)} pictures; give the answer for one frame"
            )
        obj = next(iter(items))
    read = _read_by(obj)
    return None if read is None else read(obj, frame_size)


def _read_by(obj: Any) -> Callable[[Any, tuple[int, int]], Parts] | None:
    """What reads an object of this form."""
    if hasattr(obj, "xyxy") and hasattr(obj, "mask"):
        return _parts_of_supervision
    if all(hasattr(obj, name) for name in ("boxes", "masks", "names", "orig_shape")):
        return _parts_of_ultralytics
    return None


def _parts_of_supervision(obj: Any, frame_size: tuple[int, int]) -> Parts:
    del frame_size  # masks are the frame's
    data = getattr(obj, "data", None)
    data = data if isinstance(data, Mapping) else {}
    return {
        "boxes": obj.xyxy,
        "masks": obj.mask,
        "scores": getattr(obj, "confidence", None),
        "class_ids": getattr(obj, "class_id", None),
        "labels": data.get("class_name"),
    }


def _parts_of_ultralytics(obj: Any, frame_size: tuple[int, int]) -> Parts:
    detected_in = check_size(obj.orig_shape)
    if detected_in != frame_size:
        raise SourceError(
            f"the detector saw a picture of {say_size(detected_in)}, the frame is "
            f"{say_size(frame_size)} (width x height); give both the same picture"
        )
    boxes, masks = obj.boxes, obj.masks
    planes = getattr(masks, "data", None)
    if boxes is None and planes is None:
        raise SourceError(
            "the Results hold neither boxes nor masks; give those of a model that detects or "
            "segments"
        )
    parts = {
        "boxes": getattr(boxes, "xyxy", None),
        "scores": getattr(boxes, "conf", None),
        "class_ids": getattr(boxes, "cls", None),
        "class_names": obj.names or None,
    }
    if planes is not None:
        parts["masks"] = _out_of_letterbox(host_array(planes, "masks"), frame_size)
    return parts


def _out_of_letterbox(planes: np.ndarray, frame_size: tuple[int, int]) -> _Planes:
    """Masks over a network's input, cut to the frame, brought to its size and cut at a half."""
    if planes.ndim != 3 or planes.dtype.kind not in "buif":
        raise SourceError(f"masks are {planes.dtype} {planes.shape}; give numbers [N, H, W]")
    if 0 in planes.shape:
        return np.zeros((0, *frame_size), bool)
    if planes.dtype.kind == "f" and not np.isfinite(planes).all():
        raise SourceError("masks hold NaN or infinity; give finite numbers")
    box = Letterbox.fit(frame_size, (planes.shape[1], planes.shape[2]))

    def plane(row: int) -> Bool[np.ndarray, "H W"]:
        return box.plane_to_frame(planes[row].astype(np.float32)) > 0.5

    return gather(plane, len(planes), frame_size)


def _parts_of_sam(items: Sequence[Any], frame_size: tuple[int, int]) -> Parts:
    def plane(row: int) -> Bool[np.ndarray, "H W"]:
        found = items[row]["segmentation"]
        if isinstance(found, Mapping):
            counts = found.get("counts")
            text = counts.decode("ascii", "replace") if isinstance(counts, bytes) else counts
            found = decode_segmentation({**found, "counts": text}, frame_size)
        array = host_array(found, "masks")
        if array.ndim != 2 or array.dtype.kind not in "bui":
            raise SourceError(f"mask {row} is {array.dtype} {array.shape}; give booleans [H, W]")
        return fit_plane(array.astype(bool, copy=False), frame_size, f"mask {row}").view(bool)

    parts: dict[str, Any] = {"masks": gather(plane, len(items), frame_size)}
    if all("predicted_iou" in item for item in items):
        # The network estimates an overlap, at times beyond 1.
        estimates = host_array([item["predicted_iou"] for item in items], "values of predicted_iou")
        parts["scores"] = np.minimum(estimates, 1) if estimates.dtype.kind == "f" else estimates
    return parts


def gather(
    plane: Callable[[int], Bool[np.ndarray, "H W"]], num: int, frame_size: tuple[int, int]
) -> _Planes:
    """Masks made one after the other.

    Raises:
      UnreadableFrame: If they are too many, or take more than is meant for a frame.
    """
    require_room(num, frame_size, "the detector's answer")
    planes = np.zeros((num, *frame_size), bool)
    for row in range(num):
        planes[row] = plane(row)
    return planes
