"""Masks run-length encoded, decoded and measured, with the types that pycocotools lacks."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pycocotools.mask
from jaxtyping import Bool, Int, UInt8

from remind_jax.tracks import Rle

# Its stubs know neither bytes in `counts` nor lists of masks.
_coco: Any = pycocotools.mask


def encode_masks(masks: Bool[np.ndarray, "N H W"]) -> tuple[Rle, ...]:
    """Run-length encodes pixel masks, one COCO RLE per mask."""
    if not len(masks):
        return ()
    return tuple(_coco.encode(np.asfortranarray(np.moveaxis(masks, 0, -1).astype(np.uint8))))


def decode_mask(rle: Rle) -> UInt8[np.ndarray, "H W"]:
    """The mask as pixels, 1 inside."""
    return _coco.decode(rle)


def mask_box(rle: Rle) -> tuple[int, int, int, int]:
    """Left, top, width and height in pixels of the smallest box around a mask; zero if empty."""
    left, top, width, height = (int(side) for side in _coco.toBbox(rle))
    return left, top, width, height


def mask_areas(rles: Sequence[Rle]) -> Int[np.ndarray, "N"]:
    """Pixels of each mask."""
    return np.array([int(_coco.area(rle)) for rle in rles], int)


def union_area(rles: Sequence[Rle]) -> int:
    """Pixels that at least one mask holds."""
    return int(_coco.area(_coco.merge(list(rles)))) if rles else 0
