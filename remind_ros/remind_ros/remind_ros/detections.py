"""Detections of ROS messages as those of the tracker."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from jaxtyping import Bool, Int

from remind_jax.errors import SourceError
from remind_jax.frame import Detections, fill_boxes
from remind_jax.sources.class_names import UNNAMED_CLASS

_ROUNDING = 1e-5  # of a detector's score in 32 bits


def read_detections(
    frame_size: tuple[int, int],
    instance_map: Int[np.ndarray, "H W"] | None,
    boxes: Any,
    class_names: Mapping[str, str],
) -> Detections:
    """Detections of an image, in the detector's order.

    Args:
      frame_size: Height and width of the image in pixels.
      instance_map: 0 is nothing. Beside boxes, `k + 1` marks the pixels of box `k`; alone, every
        number is an instance.
      boxes: A `vision_msgs/Detection2DArray`, or None. Without a map, each box is taken for the
        object's mask, with the background that it contains.
      class_names: What to call the class ids of hypotheses; others keep their id.

    Raises:
      SourceError: If both are missing, the map is not as large as the image, or a box is not
        finite.
    """
    if instance_map is not None and instance_map.shape != frame_size:
        shown = "x".join(map(str, instance_map.shape[::-1]))
        raise SourceError(
            f"the instance map has {shown} pixels and the image {frame_size[1]}x{frame_size[0]}; "
            "send a map of the same size"
        )
    if boxes is None and instance_map is None:
        raise SourceError("an image came with neither an instance map nor detections")
    if boxes is None:
        numbers = np.unique(instance_map[instance_map != 0])  # pyright: ignore[reportOptionalSubscript]
        labels = [class_names.get(UNNAMED_CLASS, UNNAMED_CLASS)] * len(numbers)
        return Detections.create(instance_map == numbers[:, None, None], labels)
    seen = list(boxes.detections)
    if instance_map is not None:
        numbers = np.arange(1, len(seen) + 1)
        masks = instance_map == numbers[:, None, None]
    else:
        masks = np.array([_fill(one.bbox, frame_size) for one in seen], bool)
        masks = masks.reshape(-1, *frame_size)
    best = [_best_hypothesis(one) for one in seen]
    labels = [class_names.get(class_id, class_id) for class_id, _ in best]
    return Detections.create(masks, labels, [score for _, score in best])


def _best_hypothesis(detection: Any) -> tuple[str, float]:
    """Class id and score of the likeliest hypothesis."""
    said = [getattr(one, "hypothesis", one) for one in detection.results]  # without one in ROS 1
    rated = [(str(getattr(h, "class_id", getattr(h, "id", ""))), float(h.score)) for h in said]
    class_id, score = max(rated, key=lambda one: one[1], default=(UNNAMED_CLASS, 1.0))
    if 1.0 < score < 1.0 + _ROUNDING:
        score = 1.0
    return class_id or UNNAMED_CLASS, score if np.isfinite(score) else 0.0


def _fill(box: Any, frame_size: tuple[int, int]) -> Bool[np.ndarray, "H W"]:
    """The pixels of a box, which may be turned about its center."""
    middle = getattr(box.center, "position", box.center)  # a Pose2D in ROS 1
    x, y, theta = middle.x, middle.y, box.center.theta
    width, height = box.size_x, box.size_y
    numbers = [float(number) for number in (x, y, width, height, theta)]
    if not np.isfinite(numbers).all() or width < 0 or height < 0:
        raise SourceError(
            f"a box is {numbers} (center, size, angle); its numbers must be finite, its size not "
            "negative"
        )
    if theta == 0:
        corners = [x - width / 2, y - height / 2, x + width / 2, y + height / 2]
        return fill_boxes(np.array([corners]), frame_size)[0]
    rows, columns = np.mgrid[: frame_size[0], : frame_size[1]] + 0.5
    along = (columns - x) * np.cos(theta) + (rows - y) * np.sin(theta)
    across = (rows - y) * np.cos(theta) - (columns - x) * np.sin(theta)
    return (np.abs(along) <= width / 2) & (np.abs(across) <= height / 2)
