"""Reduces the pixel masks of a frame to what the tracker needs of them (host, OpenCV).

Letters: `N` detections, `S` slots (at least N), `H W` pixels, `Hp Wp` patches.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any, Literal

import cv2
import numpy as np
from jaxtyping import Bool, Float, Int

from remind_jax.crops import Crops
from remind_jax.masks.relations import find_row_ends, relate_masks
from remind_jax.observation import AnyFeats, FrameFeats, MaskRelations, Masks

SanitizeMode = Literal["convex_hull", "morphology", "none"]


def reduce_masks(
    masks: Bool[np.ndarray, "N H W"] | Crops,
    class_ids: np.ndarray,
    scores: np.ndarray,
    *,
    num_slots: int,
    patch_px: int,
    sanitize: SanitizeMode = "convex_hull",
    fill_holes: bool = True,
    close_px: int = 3,
    open_px: int = 0,
    keep_largest: bool = False,
    erosion_px: int = 0,
    scale_min_px: float = 40.0,
    exact_gap_max: float | None = 1.75,
) -> Masks:
    """Reduces pixel masks to patch coverage and geometry, padded to `num_slots`.

    An empty mask, or one that erosion leaves empty, gives an invalid slot: it is no detection.

    Args:
      patch_px: Side of a patch in pixels; pixels beyond the last whole patch do not count.
      sanitize: How concave masks are filled before the background around them is looked at
        (method.md#filled-mask).
      fill_holes: Fill the holes of masks in mode "morphology".
      close_px: Side of the closing square of mode "morphology".
      open_px: Side of the opening square of mode "morphology", 0 for none.
      keep_largest: Look at the background around the largest piece of a mask only; not in mode
        "none".
      erosion_px: Pixels that a mask loses on every side before anything is measured, none of them
        where it reaches the box around it (method.md#mask-geometry).
      scale_min_px: Least length that gaps between masks are measured in.
      exact_gap_max: Gaps up to this many lengths are measured between the masks themselves; None:
        no gap is measured, and nothing goes by the square of the masks.
    """
    crops = Crops.of(masks).eroded(erosion_px, margin_px=0)
    num, height_px, width_px = crops.shape
    size, grid = (height_px, width_px), (height_px // patch_px, width_px // patch_px)
    coverage = np.zeros((num_slots, *grid), np.float32)
    filled_coverage = np.zeros((num_slots, *grid), np.float32)
    quality = np.zeros(num_slots)
    box, center = np.zeros((num_slots, 4)), np.zeros((num_slots, 2))
    area = np.zeros(num_slots)
    valid = np.zeros(num_slots, bool)
    margin = close_px + open_px if sanitize == "morphology" else 0
    ends: list[np.ndarray | None] = [None] * num
    for slot in range(num):
        region = left, top, width, height = crops.box(slot)
        if not width:
            continue
        valid[slot] = True
        box[slot] = left, top, left + width, top + height
        tight = crops.region(slot, slice(top, top + height), slice(left, left + width))
        ends[slot] = find_row_ends(tight, left, top)
        rows, columns = _window(region, margin, patch_px, size)
        patches = np.s_[
            rows.start // patch_px : rows.stop // patch_px,
            columns.start // patch_px : columns.stop // patch_px,
        ]
        inside = crops.region(slot, rows, columns).view(np.uint8)
        summed = cv2.integral(inside)
        area[slot] = num_pixels = int(summed[-1, -1])
        center[slot] = (
            left + (_sum_of_places(summed[-1]) - num_pixels * (left - columns.start)) / num_pixels,
            top + (_sum_of_places(summed[:, -1]) - num_pixels * (top - rows.start)) / num_pixels,
        )
        coverage[slot][patches] = patch_coverage(summed, patch_px)
        if sanitize == "none":
            quality[slot] = 1.0
            filled_coverage[slot] = coverage[slot]
            continue
        solid, solid_ends = inside, ends[slot]
        if keep_largest:
            solid = _largest_piece(inside)
            left, top, width, height = cv2.boundingRect(solid)
            piece = solid[top : top + height, left : left + width].view(bool)
            solid_ends = find_row_ends(piece, left + columns.start, top + rows.start)
        if sanitize == "convex_hull":
            assert solid_ends is not None
            filled = np.zeros_like(inside, order="C")
            hull = cv2.convexHull(solid_ends - np.array([columns.start, rows.start], np.int32))
            cv2.fillConvexPoly(filled, hull, 1)
        else:
            filled = _fill_gaps(solid, fill_holes, close_px, open_px)
        summed = cv2.integral(filled)
        filled_area = int(summed[-1, -1])
        hole = max(0, filled_area - num_pixels)
        quality[slot] = min(1.0, max(0.0, 1.0 - hole / max(1, filled_area)))
        filled_coverage[slot][patches] = patch_coverage(summed, patch_px)
    return Masks(
        coverage=coverage,
        filled_coverage=filled_coverage,
        quality=quality,
        box=box,
        center=center,
        area=area,
        class_id=_pad(np.asarray(class_ids, np.int32), num_slots),
        detector_score=_pad(np.asarray(scores, np.float32), num_slots),
        relations=relate_masks(
            crops,
            box,
            area,
            ends,
            num_slots=num_slots,
            scale_min_px=scale_min_px,
            exact_gap_max=exact_gap_max,
        ),
        valid=valid,
    )


def pad_feats(frame_feats: AnyFeats, num_slots: int) -> AnyFeats:
    """Adds empty slots at the end of what is told of each detection."""
    if isinstance(frame_feats, FrameFeats) or len(frame_feats.patches) == num_slots:
        return frame_feats
    return dataclasses.replace(
        frame_feats,
        patches=_pad(frame_feats.patches, num_slots),
        coverage=_pad(frame_feats.coverage, num_slots),
    )


def pad_masks(masks: Masks, num_slots: int) -> Masks:
    """Adds empty slots at the end."""
    if len(masks.valid) == num_slots:
        return masks
    parts = {field.name: getattr(masks, field.name) for field in dataclasses.fields(masks)}
    between: MaskRelations = parts.pop("relations")
    relations = MaskRelations(
        gap_px=_pad(between.gap_px, num_slots, axes=2),
        exact=_pad(between.exact, num_slots, axes=2),
        touches_border=_pad(between.touches_border, num_slots),
    )
    return Masks(
        relations=relations, **{name: _pad(part, num_slots) for name, part in parts.items()}
    )


def _pad(leaf: Any, num_slots: int, axes: int = 1) -> Any:
    """The array with zeros for more slots along its first axes; None stays."""
    if leaf is None:
        return None
    padded = np.zeros((num_slots,) * axes + leaf.shape[axes:], leaf.dtype)
    padded[tuple(map(slice, leaf.shape[:axes]))] = leaf
    return padded


def patch_coverage(
    summed: Int[np.ndarray, "rows columns"], patch_px: int
) -> Float[np.ndarray, "Hp Wp"]:
    """Share of each whole patch that is inside a pixel mask; exact multiples of 1/patch area.

    Args:
      summed: Pixels of the mask above and to the left of every corner of a pixel (the table that
        `cv2.integral` makes): one row and one column more than the mask.
      patch_px: Side of a patch in pixels; the first one starts at the first pixel.
    """
    at = summed[::patch_px, ::patch_px]
    counts = at[1:, 1:] - at[:-1, 1:] - at[1:, :-1] + at[:-1, :-1]
    return (counts * np.float32(1.0 / patch_px**2)).astype(np.float32)


def _window(
    region: Sequence[int], margin: int, patch_px: int, size: tuple[int, int]
) -> tuple[slice, slice]:
    """Rows and columns of the whole patches that hold a box and its margin.

    What lies beyond the last whole patch of the frame is included up to the frame's end.
    """
    left, top, width, height = region

    def whole(start: int, length: int, most: int) -> slice:
        first = max(0, start - margin) // patch_px * patch_px
        return slice(first, min(most, -(-(start + length + margin) // patch_px) * patch_px))

    return whole(top, height, size[0]), whole(left, width, size[1])


def _sum_of_places(summed: Int[np.ndarray, "corners"]) -> int:
    """The sum of the places 0, 1, 2, ... of all pixels, of which `summed` lie before each place."""
    return (len(summed) - 1) * int(summed[-1]) - int(summed[1:].sum())


def _largest_piece(pixels: np.ndarray) -> np.ndarray:
    """The largest 8-connected piece of a mask, the first among equals."""
    _, labels, stats, _ = cv2.connectedComponentsWithStats(pixels, connectivity=8)
    return (labels == 1 + np.argmax(stats[1:, cv2.CC_STAT_AREA])).astype(np.uint8)


def _fill_gaps(pixels: np.ndarray, fill_holes: bool, close_px: int, open_px: int) -> np.ndarray:
    """A mask without holes, closed and opened."""
    filled = pixels
    if fill_holes:
        flooded = np.pad(pixels, 1)
        cv2.floodFill(flooded, None, (0, 0), 2, flags=4)
        filled = (flooded != 2).astype(np.uint8)[1:-1, 1:-1]
    for side, operation in ((close_px, cv2.MORPH_CLOSE), (open_px, cv2.MORPH_OPEN)):
        if side > 0:
            filled = cv2.morphologyEx(filled, operation, np.ones((side, side), np.uint8))
    return np.ascontiguousarray(filled)
