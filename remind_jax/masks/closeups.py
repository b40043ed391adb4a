"""Closeups: every detection in a picture of its own, at a size of its own (host, OpenCV).

From afar and from near, an object covers few patches of the frame or many, of which each shows
more or less of it. In closeups it covers about as many patches wherever it is seen.

Letters: `N` detections, `H W` pixels of the frame, `S` pixels and `V` patches along a side of a
closeup.
"""

from __future__ import annotations

import dataclasses

import cv2
import numpy as np
from jaxtyping import Bool, Float, UInt8

from remind_jax.crops import Crops

CLOSEUP_PATCHES = 9  # along a side of a closeup
OBJECT_PATCHES = 4.0  # side of the mask in it, as the root of its area
MARGIN_PATCHES = 1.0  # that are left free of the mask at least, both sides together
MOST_ZOOM = 6.0  # more shows nothing more


@dataclasses.dataclass(frozen=True)
class Closeups:
    """Pictures of the detections of a frame; those of empty masks are black and cover nothing."""

    images: UInt8[np.ndarray, "N S S 3"]  # RGB
    coverage: Float[np.ndarray, "N V V"]  # share of each patch inside the mask, [0, 1]

    def __len__(self) -> int:
        return len(self.images)


def cut_closeups(
    image: UInt8[np.ndarray, "H W 3"], masks: Bool[np.ndarray, "N H W"] | Crops, patch_px: int
) -> Closeups:
    """Cuts a square out of the frame around each mask, and scales it (method_plus.md#closeups).

    What lies beyond the border of the frame continues its last pixels.
    """
    crops = Crops.of(masks)
    num, side = len(crops), CLOSEUP_PATCHES * patch_px
    images = np.zeros((num, side, side, 3), np.uint8)
    coverage = np.zeros((num, CLOSEUP_PATCHES, CLOSEUP_PATCHES), np.float32)
    for row, pixels in enumerate(crops.areas):
        if not pixels:
            continue
        left, top, width, height = crops.box(row)
        scale = min(
            OBJECT_PATCHES * patch_px / np.sqrt(pixels),
            (CLOSEUP_PATCHES - MARGIN_PATCHES) * patch_px / max(width, height),
            MOST_ZOOM,
        )
        window = max(1, round(side / scale))
        x, y = round(left + (width - window) / 2), round(top + (height - window) / 2)
        # The part of the window that lies in the frame.
        columns = slice(max(x, 0), min(x + window, image.shape[1]))
        rows = slice(max(y, 0), min(y + window, image.shape[0]))
        above, below = rows.start - y, y + window - rows.stop
        beyond = above, below, columns.start - x, x + window - columns.stop
        cut = cv2.copyMakeBorder(image[rows, columns], *beyond, cv2.BORDER_REPLICATE)
        how = cv2.INTER_AREA if window > side else cv2.INTER_LINEAR
        images[row] = cv2.resize(cut, (side, side), interpolation=how)
        inside = crops.region(row, rows, columns).astype(np.float32)
        inside = cv2.copyMakeBorder(inside, *beyond, cv2.BORDER_CONSTANT, value=0.0)
        coverage[row] = cv2.resize(inside, coverage.shape[1:], interpolation=cv2.INTER_AREA)
    return Closeups(images, coverage)
