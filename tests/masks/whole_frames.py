"""Masks reduced plainly, with every operation on the whole frame: what the quick way must equal."""

import cv2
import numpy as np

from remind_jax.crops import Crops


def reduce_on_whole_frames(
    masks, *, patch_px, sanitize, fill_holes, close_px, open_px, keep_largest, erosion_px
):
    """Coverage, filled coverage, quality, box, center, area and validity of every mask."""
    masks = np.asarray(Crops.of(masks).eroded(erosion_px, margin_px=0))
    rows = []
    for mask in masks:
        pixels = mask.view(np.uint8)
        grid = cover(pixels, patch_px)
        if not mask.any():
            rows.append((grid, grid, 0.0, np.zeros(4), np.zeros(2), 0, False))
            continue
        y, x = mask.nonzero()
        box = np.array([x.min(), y.min(), x.max() + 1, y.max() + 1], float)
        center = box[0] + (x - x.min()).sum() / len(x), box[1] + (y - y.min()).sum() / len(y)
        solid = largest_piece(pixels) if keep_largest and sanitize != "none" else pixels
        filled = fill(solid, sanitize, fill_holes, close_px, open_px)
        num_filled = int(filled.sum())
        quality = min(1.0, 1.0 - max(0, num_filled - len(x)) / max(1, num_filled))
        filled_grid = cover(filled, patch_px)
        rows.append((grid, filled_grid, quality, box, np.array(center), len(x), True))
    return [np.array(values) for values in zip(*rows, strict=True)]


def cover(pixels, patch_px):
    height, width = (side // patch_px for side in pixels.shape)
    whole = pixels[: height * patch_px, : width * patch_px]
    counts = whole.reshape(height, patch_px, width, patch_px).sum(axis=(1, 3), dtype=np.int64)
    return (counts * np.float32(1.0 / patch_px**2)).astype(np.float32)


def largest_piece(pixels):
    _, labels, stats, _ = cv2.connectedComponentsWithStats(pixels, connectivity=8)
    return (labels == 1 + np.argmax(stats[1:, cv2.CC_STAT_AREA])).astype(np.uint8)


def fill(pixels, mode, fill_holes, close_px, open_px):
    if mode == "none":
        return pixels
    if mode == "convex_hull":
        filled = np.zeros_like(pixels)
        cv2.fillConvexPoly(filled, cv2.convexHull(cv2.findNonZero(pixels)), 1)
        return filled
    filled = pixels
    if fill_holes:
        flooded = np.pad(pixels, 1)
        cv2.floodFill(flooded, None, (0, 0), 2, flags=4)
        filled = np.ascontiguousarray((flooded != 2).astype(np.uint8)[1:-1, 1:-1])
    for side, operation in ((close_px, cv2.MORPH_CLOSE), (open_px, cv2.MORPH_OPEN)):
        if side > 0:
            filled = cv2.morphologyEx(filled, operation, np.ones((side, side), np.uint8))
    return filled
