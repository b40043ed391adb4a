"""All images of a world packed into one big picture, so that one look-up textures a frame."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import cv2
import numpy as np
from jaxtyping import Float, UInt8

NUM_LEVELS = 4
_GUTTER_PX = 2


@dataclasses.dataclass(frozen=True, eq=False)
class Atlas:
    """Packed images; level `k` is an image at `1 / 2^k` of its size."""

    pixels: UInt8[np.ndarray, "h w c"] | Float[np.ndarray, "h w c"]
    origins: Float[np.ndarray, "n levels 2"]  # x, y of the upper left texel's center

    @property
    def num_levels(self) -> int:
        """How many sizes there are of each image."""
        return self.origins.shape[1]


def pack_images(images: Sequence[np.ndarray], num_levels: int = NUM_LEVELS) -> Atlas:
    """Packs images and their smaller versions; equal images share their place."""
    unique: dict[tuple[tuple[int, ...], bytes], int] = {}
    rows = []
    for image in images:
        rows.append(unique.setdefault((image.shape, image.tobytes()), len(unique)))
    kept = [images[rows.index(row)] for row in range(len(unique))]
    levels = [level for image in kept for level in _shrink(image, num_levels)]
    pixels, origins = _pack(levels)
    return Atlas(pixels, origins.reshape(len(kept), num_levels, 2)[rows])


def _shrink(image: np.ndarray, num_levels: int) -> list[np.ndarray]:
    levels = [image]
    for _ in range(num_levels - 1):
        height, width = levels[-1].shape[:2]
        size = (max(1, (width + 1) // 2), max(1, (height + 1) // 2))
        levels.append(cv2.resize(levels[-1], size, interpolation=cv2.INTER_AREA))
    return levels


def _pack(images: Sequence[np.ndarray]) -> tuple[np.ndarray, Float[np.ndarray, "n 2"]]:
    """Places images in rows of falling height; each gets a border of its own edge texels."""
    sizes = np.array([image.shape[:2] for image in images]) + 2 * _GUTTER_PX
    area = float(np.prod(sizes, axis=1).sum())
    width = max(int(sizes[:, 1].max()), int(np.sqrt(1.1 * area)) + 1)
    corners = np.zeros((len(images), 2), int)
    x = y = row_height = 0
    for index in np.argsort(-sizes[:, 0], kind="stable"):
        height_px, width_px = sizes[index]
        if x + width_px > width:
            x, y, row_height = 0, y + row_height, 0
        corners[index] = x, y
        x, row_height = x + width_px, max(row_height, height_px)
    pixels = np.zeros((y + row_height, width, images[0].shape[2]), images[0].dtype)
    for image, (left, top) in zip(images, corners, strict=True):
        gutter = _GUTTER_PX
        bordered = cv2.copyMakeBorder(image, gutter, gutter, gutter, gutter, cv2.BORDER_REPLICATE)
        height_px, width_px = bordered.shape[:2]
        pixels[top : top + height_px, left : left + width_px] = bordered
    return pixels, corners.astype(np.float64) + _GUTTER_PX
