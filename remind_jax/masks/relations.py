"""Measures how far the pixel masks of a frame are apart (host, OpenCV; method.md#mask-gap).

Letters: `N` detections, `S` slots (at least N), `H W` pixels.
"""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from jaxtyping import Bool, Float, Int, Num

from remind_jax.observation import MaskRelations

_STRAIGHT, _DIAGONAL = 0.955, 1.3693  # steps of the distance transform in pixels


def relate_masks(
    masks: Bool[np.ndarray, "N H W"],
    boxes: Float[np.ndarray, "S 4"],
    areas: Num[np.ndarray, "S"],
    ends: Sequence[Int[np.ndarray, "_ 2"] | None],
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
      boxes: Tight boxes of the masks: left, top, right, bottom, right and bottom excluded; rows
        beyond the masks are not read.
      areas: Pixels of the masks, likewise; empty masks have no exact gap.
      ends: What `find_row_ends` gives of every mask; an empty one has none.
      num_slots: Slots of the result, at least the number of masks.
      scale_min_px: Least length that gaps are compared with, see `thresholds.relations`.
      exact_gap_max: Pairs whose boxes are at most this many lengths apart are measured exactly.
        A sweep over the threshold of this name needs its largest value here.

    Returns:
      MaskRelations of NumPy arrays.
    """
    num = len(masks)
    boxes, areas = np.asarray(boxes, np.float64)[:num], np.asarray(areas, np.float64)[:num]
    box_gap_px = _gap_between_boxes(boxes)
    side = np.sqrt(areas)
    scale_px = np.maximum(scale_min_px, 0.5 * (side[:, None] + side))
    present = areas > 0
    close = present[:, None] & present & (box_gap_px <= exact_gap_max * scale_px)
    np.fill_diagonal(close, False)

    gap_px = np.where(np.eye(num, dtype=bool), 0.0, box_gap_px)
    first, second = np.nonzero(np.triu(close))
    gaps = _measure_gaps(masks, boxes.astype(int), ends, first, second)
    gap_px[first, second] = gap_px[second, first] = gaps

    height, width = masks.shape[1:]
    left, top, right, bottom = boxes.T
    at_border = (left <= 0) | (top <= 0) | (right >= width) | (bottom >= height)
    slots = (num_slots, num_slots)
    result = MaskRelations(np.zeros(slots), np.zeros(slots, bool), np.zeros(num_slots, bool))
    result.gap_px[:num, :num] = gap_px
    result.exact[:num, :num] = close
    result.touches_border[:num] = present & at_border
    return result


def _measure_gaps(
    masks: np.ndarray,
    corners: np.ndarray,
    ends: Sequence[np.ndarray | None],
    first: np.ndarray,
    second: np.ndarray,
) -> Float[np.ndarray, "M"]:
    """Exact gaps of M pairs, each with a distance transform of the few pixels that matter.

    Some pixels of the two masks bound the gap from above; only pixels that close to the other box
    can be nearest.
    """
    pixels = masks.view(np.uint8)
    marks = np.zeros((len(masks), 8, 2), int)
    for index in np.unique([first, second]).tolist():
        marks[index] = _extreme_pixels(ends[index], corners[index])
    steps = np.abs(marks[first][:, :, None] - marks[second][:, None])
    most, least = steps.max(axis=-1), steps.min(axis=-1)
    bound_px = (_STRAIGHT * (most - least) + _DIAGONAL * least).min(axis=(1, 2))
    reach = (bound_px / _STRAIGHT).astype(int)[:, None] + 1
    reach = np.concatenate([-reach, -reach, reach, reach], axis=1)
    source = _intersect(corners[first], corners[second] + reach)
    target = _intersect(corners[second], corners[first] + reach)
    shared = _intersect(corners[first], corners[second])
    region = np.minimum(source, target)
    region[:, 2:] = np.maximum(source, target)[:, 2:]

    gaps = np.empty(len(first))
    corner = region[:, [0, 1, 0, 1]]
    for pair, (one, other, both, around, there, offset) in enumerate(
        zip(
            *(x.tolist() for x in (first, second, shared, region, target, target - corner)),
            strict=True,
        )
    ):
        if both[0] < both[2] and both[1] < both[3]:
            num_shared = np.count_nonzero(_crop(masks[one], both) & _crop(masks[other], both))
            if num_shared:
                gaps[pair] = -np.sqrt(num_shared)
                continue
        outside = 1 - _crop(pixels[one], around)
        distance_px = cv2.distanceTransform(outside, cv2.DIST_L2, 3)
        nearest = cv2.minMaxLoc(_crop(distance_px, offset), _crop(pixels[other], there))
        gaps[pair] = nearest[0]
    return gaps


def find_row_ends(
    mask: Bool[np.ndarray, "H W"], left: int = 0, top: int = 0
) -> Int[np.ndarray, "ends 2"]:
    """First and last pixel of every row of a mask that has some, as x and y.

    The first ones of all rows come first, then the last ones. They have the hull of all pixels.

    Args:
      mask: The box around a mask, or all of the frame.
      left: Where it lies in the frame, in pixels.
      top: Likewise.
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


def _extreme_pixels(ends: np.ndarray | None, corner: np.ndarray) -> Int[np.ndarray, "8 2"]:
    """Both ends of the outermost rows and columns of a mask, as x and y, from those of all rows."""
    assert ends is not None  # no gap of an empty mask is measured
    num = len(ends) // 2
    (in_left,) = (ends[:num, 0] == corner[0]).nonzero()
    (in_right,) = (ends[num:, 0] == corner[2] - 1).nonzero()
    outermost = [0, num - 1, in_left[0], in_left[-1]]
    return ends[[*outermost, num, 2 * num - 1, num + in_right[0], num + in_right[-1]]]


def _intersect(one: np.ndarray, other: np.ndarray) -> Int[np.ndarray, "M 4"]:
    """Common part of boxes, empty where they are apart."""
    low = np.maximum(one[:, :2], other[:, :2])
    return np.concatenate([low, np.maximum(low, np.minimum(one[:, 2:], other[:, 2:]))], axis=1)


def _crop(image: np.ndarray, box: list[int]) -> np.ndarray:
    left, top, right, bottom = box
    return image[top:bottom, left:right]


def _gap_between_boxes(boxes: np.ndarray) -> Float[np.ndarray, "N N"]:
    """Gap of every two boxes, negative where they overlap."""
    low, high = boxes[:, :2], boxes[:, 2:]
    apart = np.maximum(0.0, np.maximum(low[:, None] - high, low - high[:, None]))
    common = np.maximum(0.0, np.minimum(high[:, None], high) - np.maximum(low[:, None], low))
    gap = np.sqrt((apart**2).sum(axis=-1))
    return np.where((apart > 0).any(axis=-1), gap, -np.sqrt(common.prod(axis=-1)))
