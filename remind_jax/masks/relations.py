"""Measures how far the pixel masks of a frame are apart (host, OpenCV; method.md#mask-gap).

Letters: `N` detections, `S` slots (at least N), `H W` pixels.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import cv2
import numpy as np
from jaxtyping import Bool, Float, Int, Num

from remind_jax.crops import Crops
from remind_jax.observation import MaskRelations

# Steps of OpenCV's distance transform in ten thousandths of a pixel: 0.955 and 1.3693 pixels.
_STRAIGHT, _DIAGONAL, _UNITS = 9550, 13693, 10_000
_ROWS_AT_ONCE = 256  # of the table of gaps, so that tables in between stay small
_SAMPLED = 8  # of so many ends of rows, one bounds a gap


def relate_masks(
    masks: Crops,
    boxes: Float[np.ndarray, "S 4"],
    areas: Num[np.ndarray, "S"],
    ends: Sequence[Int[np.ndarray, "_ 2"] | None],
    *,
    num_slots: int,
    scale_min_px: float = 40.0,
    exact_gap_max: float | None = 1.75,
) -> MaskRelations:
    """Gaps between all masks: exact for close pairs, between the boxes for the rest.

    The gap of masks that share n pixels is -sqrt(n). Else it is the least distance of two pixels
    in the 3x3 chamfer metric of OpenCV (0.955 per straight, 1.3693 per diagonal step).

    Args:
      boxes: Tight boxes of the masks: left, top, right, bottom, right and bottom excluded; rows
        beyond the masks are not read.
      areas: Pixels of the masks, likewise; empty masks have no exact gap.
      ends: What `find_row_ends` gives of every mask; an empty one has none.
      scale_min_px: Least length that gaps are compared with, see `thresholds.relations`.
      exact_gap_max: Pairs whose boxes are at most this many lengths apart are measured exactly.
        A sweep over the threshold of this name needs its largest value here. None: no gaps.
    """
    num = len(masks)
    boxes, areas = np.asarray(boxes, np.float64)[:num], np.asarray(areas, np.float64)[:num]
    present = areas > 0
    height, width = masks.shape[1:]
    left, top, right, bottom = boxes.T
    at_border = (left <= 0) | (top <= 0) | (right >= width) | (bottom >= height)
    touches_border = np.zeros(num_slots, bool)
    touches_border[:num] = present & at_border
    if exact_gap_max is None:
        return MaskRelations(None, None, touches_border)
    side = np.sqrt(areas)
    slots = (num_slots, num_slots)
    gaps_px, exact = np.zeros(slots), np.zeros(slots, bool)
    gap_px, close = gaps_px[:num, :num], exact[:num, :num]
    for start in range(0, num, _ROWS_AT_ONCE):
        rows = slice(start, min(start + _ROWS_AT_ONCE, num))
        gap_px[rows] = _gap_between_boxes(boxes[rows], boxes)
        scale_px = np.maximum(scale_min_px, 0.5 * (side[rows, None] + side))
        close[rows] = present[rows, None] & present & (gap_px[rows] <= exact_gap_max * scale_px)
    np.fill_diagonal(close, False)
    np.fill_diagonal(gap_px, 0.0)
    first, second = np.nonzero(close)
    first, second = first[first < second], second[first < second]
    gaps = _measure_gaps(masks, boxes.astype(int), ends, first, second)
    gap_px[first, second] = gap_px[second, first] = gaps
    return MaskRelations(gaps_px, exact, touches_border)


def _measure_gaps(
    masks: Crops,
    corners: np.ndarray,
    row_ends: Sequence[np.ndarray | None],
    first: np.ndarray,
    second: np.ndarray,
) -> Float[np.ndarray, "M"]:
    """Exact gaps of M pairs."""
    column_ends: dict[int, np.ndarray] = {}

    def ends_of(index: int, axis: int) -> np.ndarray:
        """Both ends of all rows (axis 0) or columns, as places along and across them."""
        found = row_ends[index] if axis == 0 else column_ends.get(index)
        if found is None:
            left, top, right, bottom = corners[index].tolist()
            tight = masks.region(index, slice(top, bottom), slice(left, right))
            inside = np.ascontiguousarray(tight.T)
            found = column_ends[index] = find_row_ends(inside, top, left)
        return found

    gaps = np.empty(len(first))
    boxes = corners.tolist()
    for pair, (one, other) in enumerate(zip(first.tolist(), second.tolist(), strict=True)):
        for axis in (0, 1):
            low, high = (one, other) if boxes[one][axis] < boxes[other][axis] else (other, one)
            if boxes[low][axis + 2] <= boxes[high][axis]:
                # One lies wholly behind the other: only the ends that face each other matter.
                before, behind = ends_of(low, axis), ends_of(high, axis)
                gaps[pair] = _least_distance(before[len(before) // 2 :], behind[: len(behind) // 2])
                break
        else:
            gaps[pair] = _measure_entangled(
                masks, (one, other), corners[[one, other]], ends_of(one, 0), ends_of(other, 0)
            )
    return gaps


def _least_distance(one: Int[np.ndarray, "n 2"], other: Int[np.ndarray, "m 2"]) -> float:
    """The least chamfer distance of two sets of pixels."""
    along = np.abs(other[:, 0] - one[:, 0, None])
    across = np.abs(other[:, 1] - one[:, 1, None])
    # Per step: along the longer axis, and along both.
    longer = np.maximum(along, across)
    longer *= 2 * _STRAIGHT - _DIAGONAL
    along += across
    along *= _DIAGONAL - _STRAIGHT
    along += longer
    return int(along.min()) / _UNITS


def _measure_entangled(
    masks: Crops, pair: tuple[int, int], corners: np.ndarray, *ends: np.ndarray
) -> float:
    """The gap of masks whose boxes overlap, by a distance transform of the pixels that matter.

    Some pixels of the two masks bound the gap from above; only pixels that close to the other box
    can be nearest.
    """
    one, other = pair
    both = _intersect(*corners)
    num_shared = np.count_nonzero(_mask_in(masks, one, both) & _mask_in(masks, other, both))
    if num_shared:
        return -math.sqrt(num_shared)
    reach = int(_least_distance(*(some[::_SAMPLED] for some in ends)) * _UNITS) // _STRAIGHT + 1
    grown = np.array([-reach, -reach, reach, reach])
    source = _intersect(corners[0], corners[1] + grown)
    target = _intersect(corners[1], corners[0] + grown)
    region = np.concatenate([np.minimum(source, target)[:2], np.maximum(source, target)[2:]])
    outside = 1 - _mask_in(masks, one, region).view(np.uint8)
    distance_px = cv2.distanceTransform(outside, cv2.DIST_L2, 3)
    left, top, right, bottom = (target - region[[0, 1, 0, 1]]).tolist()
    inside = _mask_in(masks, other, target).view(np.uint8)
    return cv2.minMaxLoc(distance_px[top:bottom, left:right], inside)[0]


def find_row_ends(
    mask: Bool[np.ndarray, "H W"], left: int = 0, top: int = 0
) -> Int[np.ndarray, "ends 2"]:
    """First and last pixel of every row of a mask that has some, as x and y.

    The first ones of all rows come first, then the last ones. They have the hull of all pixels.

    Args:
      mask: The box around a mask, or all of the frame.
      left: Where it lies in the frame, in pixels.
    """
    first = mask.argmax(axis=1)
    last = mask.shape[1] - 1 - mask[:, ::-1].argmax(axis=1)
    y = np.arange(len(mask))
    has_some = mask[y, first]
    if not has_some.all():
        y = np.flatnonzero(has_some)
        first, last = first[y], last[y]
    num = len(y)
    ends = np.empty((2 * num, 2), np.int32)
    ends[:num, 0], ends[num:, 0] = first + left, last + left
    ends[:num, 1] = ends[num:, 1] = y + top
    return ends


def _intersect(one: np.ndarray, other: np.ndarray) -> Int[np.ndarray, "4"]:
    """Common part of two boxes that overlap."""
    return np.concatenate([np.maximum(one[:2], other[:2]), np.minimum(one[2:], other[2:])])


def _mask_in(masks: Crops, row: int, box: np.ndarray) -> Bool[np.ndarray, "_h _w"]:
    left, top, right, bottom = box.tolist()
    return masks.region(row, slice(top, bottom), slice(left, right))


def _gap_between_boxes(
    some: Float[np.ndarray, "M 4"], boxes: Float[np.ndarray, "N 4"]
) -> Float[np.ndarray, "M N"]:
    """Gap of each of some boxes to every box, negative where they overlap."""
    apart, common = [], []
    for axis in (0, 1):  # apart: a last axis of two takes several times as long
        near, far = some[:, None, axis], some[:, None, axis + 2]
        low, high = boxes[:, axis], boxes[:, axis + 2]
        apart.append(np.maximum(0.0, np.maximum(near - high, low - far)))
        common.append(np.maximum(0.0, np.minimum(far, high) - np.maximum(near, low)))
    gap = np.sqrt(apart[0] ** 2 + apart[1] ** 2)
    return np.where(gap > 0, gap, -np.sqrt(common[0] * common[1]))
