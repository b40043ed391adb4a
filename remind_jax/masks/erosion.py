"""Masks that lose pixels on every side."""

from __future__ import annotations

import cv2
import numpy as np
from jaxtyping import Bool

from remind_jax.crops import Crops


def erode_masks(
    masks: Bool[np.ndarray, "N H W"] | Crops, radius_px: int, *, margin_px: int
) -> Crops:
    """Erodes every mask once with a square of `2 * radius_px + 1` pixels.

    Args:
      radius_px: Pixels that a mask loses on every side; 0 leaves the masks as they are.
      margin_px: What lies farther outside the box around a mask, or outside the image, counts as
        inside the mask: with the radius as margin, only the border of the image does not erode,
        with 0 the sides of the box do not either.
    """
    crops = Crops.of(masks)
    if radius_px <= 0:
        return crops
    kernel = np.ones((2 * radius_px + 1,) * 2, np.uint8)
    eroded = []
    for row in range(len(crops)):
        left, top, width, height = crops.box(row)
        if not width:
            eroded.append(((0, 0), np.zeros((0, 0), bool)))
            continue
        rows = slice(max(0, top - margin_px), min(crops.size[0], top + height + margin_px))
        columns = slice(max(0, left - margin_px), min(crops.size[1], left + width + margin_px))
        window = crops.region(row, rows, columns).view(np.uint8)
        eroded.append(((columns.start, rows.start), cv2.erode(window, kernel).view(bool)))
    return Crops.join(crops.size, eroded)
