"""From a detector's instances to those that the tracker sees: wanted classes, eroded masks.

The original stops where erosion leaves a mask empty; here such masks are dropped and counted
(method.md#detector-masks).
"""

from __future__ import annotations

import dataclasses

import cv2
import numpy as np
from jaxtyping import Bool

from remind_jax.detectors.options import DetectorOptions
from remind_jax.frame import Detections


@dataclasses.dataclass(frozen=True)
class DropCounts:
    """How many instances were dropped for their masks, by reason."""

    empty: int = 0  # the detector's mask had no pixel
    eroded: int = 0  # erosion left nothing
    small: int = 0  # fewer than `min_mask_px` pixels left

    def __add__(self, other: DropCounts) -> DropCounts:
        return DropCounts(
            self.empty + other.empty, self.eroded + other.eroded, self.small + other.small
        )

    @property
    def total(self) -> int:
        """Instances dropped for any of the reasons."""
        return self.empty + self.eroded + self.small


def refine_detections(
    detections: Detections, options: DetectorOptions
) -> tuple[Detections, DropCounts]:
    """Keeps the wanted instances and erodes their masks; the order stays.

    Args:
      detections: As they came from the detector.
      options: `confidence`, the class lists, `erosion_px` and `min_mask_px` are read.

    Returns:
      The detections left and the number of wanted ones that were dropped for their masks.
    """
    wanted = [
        row
        for row, (label, score) in enumerate(zip(detections.labels, detections.scores, strict=True))
        if score >= options.confidence and options.admits(label)
    ]
    detections = detections.select(np.asarray(wanted, int))
    before_px = detections.masks.sum(axis=(1, 2))
    masks = erode_masks(detections.masks, options.erosion_px)
    after_px = masks.sum(axis=(1, 2)) if options.erosion_px else before_px
    keep = after_px >= options.min_mask_px
    empty = before_px == 0
    eroded = ~empty & (after_px == 0)
    drops = DropCounts(int(empty.sum()), int(eroded.sum()), int((~keep & ~empty & ~eroded).sum()))
    return dataclasses.replace(detections, masks=masks).select(keep), drops


def erode_masks(masks: Bool[np.ndarray, "N H W"], radius_px: int) -> Bool[np.ndarray, "N H W"]:
    """Erodes every mask once with a square of `2 * radius_px + 1` pixels.

    What lies outside the image counts as inside the mask, so an instance that leaves the image
    is not eroded there.
    """
    if radius_px == 0 or len(masks) == 0:
        return masks
    kernel = np.ones((2 * radius_px + 1,) * 2, np.uint8)
    eroded = np.zeros_like(masks)
    for mask, out in zip(masks, eroded, strict=True):
        x, y, width, height = cv2.boundingRect(mask.view(np.uint8))
        # A margin of the radius keeps the true surroundings of every mask pixel in view.
        window = (
            slice(max(0, y - radius_px), y + height + radius_px),
            slice(max(0, x - radius_px), x + width + radius_px),
        )
        if width:
            out[window] = cv2.erode(mask[window].view(np.uint8), kernel).view(bool)
    return eroded
