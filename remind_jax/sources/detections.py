"""Detections from the forms in which people have them."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from jaxtyping import Bool

from remind_jax.crops import Crops, require_room
from remind_jax.errors import SourceError
from remind_jax.files.host_array import host_array
from remind_jax.formats.coco import decode_segmentation
from remind_jax.frame import Detections, as_masks, check_size, fill_boxes
from remind_jax.masks.letterbox import Letterbox
from remind_jax.sources.class_names import UNNAMED_CLASS
from remind_jax.sources.label_maps import fit_plane, instance_ids_in, masks_of
from remind_jax.sources.source import say_size

Parts = Mapping[str, Any]  # "masks" or "boxes", "labels" or "class_ids", "scores", "class_names"
_Planes = Bool[np.ndarray, "N H W"]
_RESULTS = ("boxes", "masks", "names", "orig_shape")  # attributes of `Results` of Ultralytics


def published_parts(obj: Any, frame_size: tuple[int, int]) -> Parts | None:
    """The parts of detections in a published form; None if they are in no such form.

    A list of one answer is that answer: models answer a list of pictures.

    Raises:
      SourceError: If it holds answers for several pictures, belongs to another picture, or neither
        masks nor boxes.
    """
    items = obj if isinstance(obj, list | tuple) and len(obj) else [obj]
    if all(isinstance(item, Mapping) and "segmentation" in item for item in items):
        return _parts_of_sam(items, frame_size)
    first: Any = items[0]
    is_supervision = hasattr(first, "xyxy") and hasattr(first, "mask")
    if not is_supervision and not all(hasattr(first, name) for name in _RESULTS):
        return None
    if len(items) > 1:
        raise SourceError(
            f"the detector answered for {len(items)} pictures; give the answer for one frame"
        )
    if not is_supervision:
        return _parts_of_ultralytics(first, frame_size)
    data = getattr(first, "data", None)
    return {
        "boxes": first.xyxy,
        "masks": first.mask,
        "scores": getattr(first, "confidence", None),
        "class_ids": getattr(first, "class_id", None),
        "labels": data.get("class_name") if isinstance(data, Mapping) else None,
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


ClassNaming = Mapping[int, str] | Sequence[str]

_PARTS = ("masks", "boxes", "labels", "class_ids", "class_names", "scores", "instance_ids")


def detections_from(
    obj: Any, frame_size: tuple[int, int], class_names: ClassNaming | None = None
) -> Detections:
    """Turns what a detector or a file gave into `Detections` of a frame.

    Arrays may be of any library that NumPy can read (`remind_jax.files.host_array`).

    Args:
      obj: One of
        - `Detections`, or None (nothing was detected);
        - `Results` of Ultralytics, `supervision.Detections` or automatic masks of SAM
          (`remind_jax.sources.detections`), also one of them in a list;
        - a mapping with `masks` and/or `boxes` (left, top, right, bottom in pixels), and optionally
          `labels`, `class_ids`, `class_names`, `scores`, `instance_ids`;
        - masks `[N, H, W]`, or one mask `[H, W]` of booleans, non-zero inside;
        - an instance map `[H, W]` of whole numbers: 0 is nothing, the rest ascending.
        Where there are boxes and no masks, the filled boxes stand in for them.
      class_names: Name per class id, where the detections bring none; for an instance map, class
        per instance id.

    Raises:
      SourceError: If the form is unknown, a class id has no name, masks show another picture, or
        an array lies where NumPy cannot read it.
    """
    if obj is None:
        return Detections.empty(*frame_size)
    if isinstance(obj, Detections):
        masks = _fit_masks(obj.masks, frame_size)
        return obj if masks is obj.masks else dataclasses.replace(obj, masks=masks)
    parts = obj if isinstance(obj, Mapping) else published_parts(obj, frame_size)
    if parts is not None:
        return _from_mapping(parts, frame_size, class_names)
    is_listed = isinstance(obj, Sequence) and not isinstance(obj, str | bytes)
    if is_listed or hasattr(obj, "__array__") or hasattr(obj, "__dlpack__"):
        return _from_array(host_array(obj, "masks"), frame_size, class_names)
    raise SourceError(
        f"detections of type {type(obj).__name__} are not understood; give masks [N, H, W], an "
        "instance map [H, W], a mapping with 'masks' or 'boxes', or what YOLO, RF-DETR or SAM give"
    )


def name_classes(class_ids: Any, class_names: ClassNaming | None) -> tuple[str, ...]:
    """Names of class ids; the number itself where no names are given.

    Raises:
      SourceError: If names are given, but not for every id.
    """
    array = host_array(class_ids, "class ids")
    is_whole = array.dtype.kind in "ui" or not array.size
    if array.dtype.kind == "f":
        is_whole = bool((np.isfinite(array) & (array % 1 == 0)).all())
    if not is_whole:
        raise SourceError(f"class ids are no whole numbers, but {array.dtype}; give whole numbers")
    ids = [int(i) for i in array.ravel()]
    if class_names is None:
        return tuple(str(i) for i in ids)
    if isinstance(class_names, str) or not isinstance(class_names, Mapping | Sequence):
        raise SourceError(
            f"class names are {str(class_names)[:40]!r}; give a list of names, or a mapping of ids"
        )
    named = class_names if isinstance(class_names, Mapping) else dict(enumerate(class_names))
    if missing := sorted({i for i in ids if i not in named}):
        known = sorted(i for i in named if isinstance(i, int))
        span = f", for {known[0]} to {known[-1]}" if known else ""
        raise SourceError(
            f"class ids {', '.join(map(str, missing))} have no name; {len(named)} names were "
            f"given{span}"
        )
    for i in ids:
        if not isinstance(named[i], str):
            raise SourceError(f"the name of class {i} is {named[i]!r}; give text")
    return tuple(str(named[i]) for i in ids)


def _from_mapping(
    parts: Mapping[str, Any], frame_size: tuple[int, int], class_names: ClassNaming | None
) -> Detections:
    unknown = sorted(str(key) for key in set(parts) - set(_PARTS))
    if unknown:
        raise SourceError(
            f"detections have the unknown part '{unknown[0]}'; allowed: {', '.join(_PARTS)}"
        )
    masks, boxes, labels = parts.get("masks"), parts.get("boxes"), parts.get("labels")
    if masks is None and boxes is None:
        raise SourceError("detections have neither 'masks' nor 'boxes'; give one of them")
    if masks is None:
        planes = fill_boxes(boxes, frame_size)
        _check_corners(host_array(boxes, "boxes"))
    else:
        planes = _as_planes(host_array(masks, "masks"), frame_size)
    if labels is None and parts.get("class_ids") is not None:
        names = parts.get("class_names")
        names = names.tolist() if isinstance(names, np.ndarray) else names
        labels = name_classes(parts["class_ids"], names or class_names)
    scores, ids = parts.get("scores"), parts.get("instance_ids")
    return Detections.create(planes, labels, scores, ids)


def _check_corners(boxes: np.ndarray) -> None:
    """Refuses boxes in another form than left, top, right, bottom in pixels."""
    boxes = boxes.reshape(-1, 4)
    if turned := np.flatnonzero((boxes[:, 2:] < boxes[:, :2]).any(axis=1)).tolist():
        raise SourceError(
            f"box {turned[0]} is {boxes[turned[0]].tolist()}, which ends before it starts; give "
            "left, top, right, bottom"
        )
    if boxes.any() and (boxes >= 0).all() and (boxes <= 1).all():
        raise SourceError(
            f"box 0 is {boxes[0].tolist()}, and all boxes lie within 0 to 1; give pixels, not "
            "shares of the frame"
        )


def _from_array(
    array: np.ndarray, frame_size: tuple[int, int], class_names: ClassNaming | None
) -> Detections:
    if array.ndim == 2 and array.shape[1] == 4 != frame_size[1] and array.size:
        raise SourceError(
            f"detections are numbers {list(array.shape)}; boxes are given as {{'boxes': ...}}"
        )
    if array.ndim == 2 and array.dtype.kind in "ui":
        ids = instance_ids_in(array)
        planes = _fit_masks(masks_of(array, ids), frame_size)
        labels = name_classes(ids, class_names) if class_names else [UNNAMED_CLASS] * len(ids)
        return Detections.create(planes, labels, instance_ids=ids)
    return Detections.create(_as_planes(array, frame_size))


def _as_planes(array: np.ndarray, frame_size: tuple[int, int]) -> Bool[np.ndarray, "N H W"] | Crops:
    if array.size == 0:
        return np.zeros((0, *frame_size), bool)
    if array.ndim == 2 and array.dtype.kind == "f" and array.max() > 1:
        raise SourceError(
            f"a mask [H, W] of {array.dtype} holds {array.max():g}; give an instance map of an "
            "integer type, or a mask of 0 and 1"
        )
    return _fit_masks(as_masks(array[None] if array.ndim == 2 else array), frame_size)


def _fit_masks(
    masks: Bool[np.ndarray, "N H W"] | Crops, frame_size: tuple[int, int]
) -> Bool[np.ndarray, "N h w"] | Crops:
    if masks.shape[1:] == frame_size:
        return masks
    planes = np.asarray(masks)
    return gather(lambda row: fit_plane(planes[row], frame_size, "a mask"), len(planes), frame_size)
