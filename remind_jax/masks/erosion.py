"""Masks that lose pixels on every side."""

from __future__ import annotations

import cv2
import numpy as np
from jaxtyping import Bool

from remind_jax.crops import Crops


def erode_masks(
    masks: Bool[np.ndarray, "N H W"] | Crops, radius_px: int, *, margin_px: int
) -> Bool[np.ndarray, "N H W"] | Crops:
    """Erodes every mask once with a square of `2 * radius_px + 1` pixels.

    Args:
      masks: Pixel masks of the frame.
      radius_px: Pixels that a mask loses on every side; 0 leaves the masks as they are.
      margin_px: What lies farther outside the box around a mask, or outside the image, counts as
        inside the mask: with the radius as margin, only the border of the image does not erode,
        with 0 the sides of the box do not either.
    """
    if radius_px <= 0:
        return masks
    if isinstance(masks, Crops):
        eroded = (erode_masks(mask[None], radius_px, margin_px=margin_px) for mask in masks)
        return Crops.of_planes((np.asarray(one)[0] for one in eroded), masks.size)
    kernel = np.ones((2 * radius_px + 1,) * 2, np.uint8)
    eroded = np.zeros_like(masks)
    for mask, out in zip(masks, eroded, strict=True):
        left, top, width, height = cv2.boundingRect(mask.view(np.uint8))
        window = np.s_[
            max(0, top - margin_px) : top + height + margin_px,
            max(0, left - margin_px) : left + width + margin_px,
        ]
        if width:
            out[window] = cv2.erode(mask[window].view(np.uint8), kernel).view(bool)
    return eroded
