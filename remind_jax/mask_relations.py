"""Measures how far the pixel masks of a frame are apart (host, OpenCV; context notes 5.1).

Letters: `N` detections, `S` slots (at least N), `H W` pixels.
"""

from __future__ import annotations

import cv2
import numpy as np
from jaxtyping import Bool, Float

from remind_jax.perception.relations import MaskRelations


def relate_masks(
    masks: Bool[np.ndarray, "N H W"],
    boxes: Float[np.ndarray, "N 4"],
    areas: Float[np.ndarray, "N"],
    *,
    num_slots: int,
    scale_min_px: float = 40.0,
    exact_gap_max: float = 1.75,
) -> MaskRelations:
    """Gaps between all masks: exact for close pairs, between the boxes for the rest.

    The gap of masks that share n pixels is -sqrt(n). Else it is the least distance of two pixels
    in the 3x3 chamfer metric of OpenCV (0.955 per straight, 1.3693 per diagonal step).

    Args:
      masks: Pixel masks of the frame.
      boxes: Tight boxes of the masks: left, top, right, bottom, right and bottom excluded.
      areas: Pixels of the masks; empty masks have no exact gap.
      num_slots: Slots of the result, at least the number of masks.
      scale_min_px: Least length that gaps are compared with, see `thresholds.relations`.
      exact_gap_max: Pairs whose boxes are at most this many lengths apart are measured exactly.
        A sweep over the threshold of this name needs its largest value here.

    Returns:
      MaskRelations of NumPy arrays.
    """
    num = len(masks)
    boxes, areas = np.asarray(boxes, np.float64)[:num], np.asarray(areas, np.float64)[:num]
    box_gap_px, boxes_meet = _relate_boxes(boxes)
    side = np.sqrt(areas)
    scale_px = np.maximum(scale_min_px, 0.5 * (side[:, None] + side))
    present = areas > 0
    close = present[:, None] & present & (box_gap_px <= exact_gap_max * scale_px)
    np.fill_diagonal(close, False)

    gap_px = box_gap_px.copy()
    pixels = masks.view(np.uint8)
    corners = boxes.astype(int)
    outlines = {
        index: _outline(pixels[index], corners[index]) for index in np.nonzero(close.any(0))[0]
    }
    for first in range(num):
        near = first + 1 + np.nonzero(close[first, first + 1 :])[0]
        if near.size:
            gaps = _gaps_from(pixels, corners, outlines, first, near, boxes_meet[first])
            gap_px[first, near] = gap_px[near, first] = gaps

    height, width = masks.shape[1:]
    left, top, right, bottom = boxes.T
    at_border = (left <= 0) | (top <= 0) | (right >= width) | (bottom >= height)
    slots = (num_slots, num_slots)
    result = MaskRelations(np.zeros(slots), np.zeros(slots, bool), np.zeros(num_slots, bool))
    result.gap_px[:num, :num] = gap_px
    result.exact[:num, :num] = close
    result.touches_border[:num] = present & at_border
    return result


def _gaps_from(
    pixels: np.ndarray,
    corners: np.ndarray,
    outlines: dict[int, tuple[np.ndarray, np.ndarray]],
    first: int,
    near: np.ndarray,
    boxes_meet: np.ndarray,
) -> Float[np.ndarray, "M"]:
    """Gaps between one mask and each of the masks `near` it, with one distance transform."""
    members = corners[[first, *near]]
    (x0, y0), (x1, y1) = members[:, :2].min(axis=0), members[:, 2:].max(axis=0)
    outside = 1 - pixels[first, y0:y1, x0:x1]
    distance_px = cv2.distanceTransform(outside, cv2.DIST_L2, 3)
    gaps = np.empty(len(near))
    for place, other in enumerate(near):
        shared = _shared_pixels(pixels, corners, first, other) if boxes_meet[other] else 0
        rows, columns = outlines[other]
        gaps[place] = -np.sqrt(shared) if shared else distance_px[rows - y0, columns - x0].min()
    return gaps


def _shared_pixels(pixels: np.ndarray, corners: np.ndarray, first: int, second: int) -> int:
    x0, y0 = np.maximum(corners[first, :2], corners[second, :2])
    x1, y1 = np.minimum(corners[first, 2:], corners[second, 2:])
    return np.count_nonzero(pixels[first, y0:y1, x0:x1] & pixels[second, y0:y1, x0:x1])


def _outline(pixels: np.ndarray, corner: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Pixels of a mask beside others; a disjoint mask is nearest to one of them."""
    left, top, right, bottom = corner
    inside = pixels[top:bottom, left:right]
    core = cv2.erode(
        inside, np.ones((3, 3), np.uint8), borderType=cv2.BORDER_CONSTANT, borderValue=0
    )
    rows, columns = np.nonzero(inside ^ core)
    return rows + top, columns + left


def _relate_boxes(boxes: np.ndarray) -> tuple[Float[np.ndarray, "N N"], Bool[np.ndarray, "N N"]]:
    """Gap of every two boxes, negative where they overlap, and whether they do."""
    low, high = boxes[:, :2], boxes[:, 2:]
    apart = np.maximum(0.0, np.maximum(low[:, None] - high, low - high[:, None]))
    common = np.maximum(0.0, np.minimum(high[:, None], high) - np.maximum(low[:, None], low))
    area = common.prod(axis=-1)
    gap = np.sqrt((apart**2).sum(axis=-1))
    return np.where((apart > 0).any(axis=-1), gap, -np.sqrt(area)), area > 0
