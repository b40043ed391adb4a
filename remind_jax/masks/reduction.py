"""Reduces the pixel masks of a frame to what the tracker needs of them (host, OpenCV).

Letters: `N` detections, `S` slots (at least N), `H W` pixels, `Hp Wp` patches.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Literal

import cv2
import numpy as np
from jaxtyping import Bool, Float

from remind_jax.masks.erosion import erode_masks
from remind_jax.masks.relations import relate_masks
from remind_jax.observation import Masks

SanitizeMode = Literal["convex_hull", "morphology", "none"]


def reduce_masks(
    masks: Bool[np.ndarray, "N H W"],
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
    exact_gap_max: float = 1.75,
) -> Masks:
    """Reduces pixel masks to patch coverage and geometry, padded to `num_slots`.

    An empty mask, or one that erosion leaves empty, gives an invalid slot: it is no detection.

    Args:
      masks: Pixel masks of the frame.
      class_ids: Class of each mask.
      scores: Detector score of each mask.
      num_slots: Slots of the result, at least the number of masks.
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
      exact_gap_max: Gaps up to this many lengths are measured between the masks themselves.

    Returns:
      Masks of NumPy arrays.
    """
    masks = erode_masks(masks, erosion_px, margin_px=0)
    num, height_px, width_px = masks.shape
    grid = (height_px // patch_px, width_px // patch_px)
    coverage = np.zeros((num_slots, *grid), np.float32)
    filled_coverage = np.zeros((num_slots, *grid), np.float32)
    quality = np.zeros(num_slots)
    box, center = np.zeros((num_slots, 4)), np.zeros((num_slots, 2))
    area = np.zeros(num_slots)
    valid = np.zeros(num_slots, bool)
    for slot, mask in enumerate(masks):
        pixels = mask.view(np.uint8)
        left, top, width, height = cv2.boundingRect(pixels)
        if not width:
            continue
        valid[slot] = True
        inside = pixels[top : top + height, left : left + width]
        per_column = cv2.reduce(inside, 0, cv2.REDUCE_SUM, dtype=cv2.CV_32S)[0]
        per_row = cv2.reduce(inside, 1, cv2.REDUCE_SUM, dtype=cv2.CV_32S)[:, 0]
        area[slot] = num_pixels = int(per_row.sum())
        box[slot] = left, top, left + width, top + height
        center[slot] = (
            left + per_column.dot(np.arange(width)) / num_pixels,
            top + per_row.dot(np.arange(height)) / num_pixels,
        )
        solid, region = pixels, (left, top, width, height)
        if keep_largest and sanitize != "none":
            solid = _largest_piece(pixels)
            region = cv2.boundingRect(solid)
        filled = _sanitize(solid, region, sanitize, fill_holes, close_px, open_px)
        filled_area = int(cv2.countNonZero(filled))
        hole = max(0, filled_area - num_pixels)
        quality[slot] = min(1.0, max(0.0, 1.0 - hole / max(1, filled_area)))
        coverage[slot] = patch_coverage(pixels, patch_px, (left, top, width, height))
        filled_coverage[slot] = (
            coverage[slot]
            if filled is pixels
            # A hull fills the box that it was made of.
            else patch_coverage(
                filled, patch_px, region if sanitize == "convex_hull" else cv2.boundingRect(filled)
            )
        )
    pad = lambda values: np.concatenate([values, np.zeros(num_slots - num, values.dtype)])  # noqa: E731
    return Masks(
        coverage=coverage,
        filled_coverage=filled_coverage,
        quality=quality,
        box=box,
        center=center,
        area=area,
        class_id=pad(np.asarray(class_ids, np.int32)),
        detector_score=pad(np.asarray(scores, np.float32)),
        relations=relate_masks(
            masks,
            box,
            area,
            num_slots=num_slots,
            scale_min_px=scale_min_px,
            exact_gap_max=exact_gap_max,
        ),
        valid=valid,
    )


def pad_masks(masks: Masks, num_slots: int) -> Masks:
    """Adds empty slots at the end."""
    lacking = num_slots - len(masks.valid)

    def pad(leaf: np.ndarray, axes: int = 1) -> np.ndarray:
        return np.pad(leaf, [(0, lacking)] * axes + [(0, 0)] * (leaf.ndim - axes))

    relations = dataclasses.replace(
        masks.relations,
        gap_px=pad(masks.relations.gap_px, 2),
        exact=pad(masks.relations.exact, 2),
        touches_border=pad(masks.relations.touches_border),
    )
    rest = {
        field.name: pad(getattr(masks, field.name))
        for field in dataclasses.fields(masks)
        if field.name != "relations"
    }
    return Masks(relations=relations, **rest)


def patch_coverage(
    pixels: np.ndarray, patch_px: int, region: Sequence[int] | None = None
) -> Float[np.ndarray, "Hp Wp"]:
    """Share of each patch that is inside a 0/1 pixel mask; exact multiples of 1/patch area.

    Args:
      pixels: The mask, `[H, W]` of uint8.
      patch_px: Side of a patch in pixels.
      region: Left, top, width and height of a box that holds all of the mask.
    """
    grid = (pixels.shape[0] // patch_px, pixels.shape[1] // patch_px)
    left, top, width, height = region or (0, 0, pixels.shape[1], pixels.shape[0])
    first_row, first_column = top // patch_px, left // patch_px
    last_row = min(grid[0], -(-(top + height) // patch_px))
    last_column = min(grid[1], -(-(left + width) // patch_px))
    rows, columns = max(0, last_row - first_row), max(0, last_column - first_column)
    part = pixels[
        first_row * patch_px : last_row * patch_px, first_column * patch_px : last_column * patch_px
    ]
    blocks = part.reshape(rows, patch_px, columns * patch_px).sum(axis=1, dtype=np.uint16)
    counts = blocks.reshape(rows, columns, patch_px).sum(axis=2, dtype=np.uint32)
    coverage = np.zeros(grid, np.float32)
    coverage[first_row:last_row, first_column:last_column] = counts * np.float32(1.0 / patch_px**2)
    return coverage


def _largest_piece(pixels: np.ndarray) -> np.ndarray:
    """The largest 8-connected piece of a mask, the first among equals."""
    _, labels, stats, _ = cv2.connectedComponentsWithStats(pixels, connectivity=8)
    return (labels == 1 + np.argmax(stats[1:, cv2.CC_STAT_AREA])).astype(np.uint8)


def _sanitize(
    pixels: np.ndarray,
    region: Sequence[int],
    mode: SanitizeMode,
    fill_holes: bool,
    close_px: int,
    open_px: int,
) -> np.ndarray:
    """The filled mask; the very same array if nothing is to be filled."""
    if mode == "none":
        return pixels
    if mode == "convex_hull":
        filled = np.zeros_like(pixels)
        left, top, width, height = region
        inside = pixels[top : top + height, left : left + width]
        ends = _row_ends(inside) + np.array((left, top), np.int32)
        cv2.fillConvexPoly(filled, cv2.convexHull(ends), 1)
        return filled
    filled = pixels
    if fill_holes:
        flooded = np.pad(pixels, 1)
        cv2.floodFill(flooded, None, (0, 0), 2, flags=4)
        filled = (flooded != 2).astype(np.uint8)[1:-1, 1:-1]
    for side, operation in ((close_px, cv2.MORPH_CLOSE), (open_px, cv2.MORPH_OPEN)):
        if side > 0:
            filled = cv2.morphologyEx(filled, operation, np.ones((side, side), np.uint8))
    return np.ascontiguousarray(filled)


def _row_ends(inside: np.ndarray) -> np.ndarray:
    """First and last pixel of every row of a mask, as x and y: they have the hull of all pixels."""
    y = np.flatnonzero(inside.any(axis=1))
    first = inside[y].argmax(axis=1)
    last = inside.shape[1] - 1 - inside[y, ::-1].argmax(axis=1)
    ends = [np.concatenate([first, last]), np.concatenate([y, y])]
    return np.stack(ends, axis=1).astype(np.int32)
