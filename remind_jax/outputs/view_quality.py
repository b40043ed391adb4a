"""How well a detection shows its object: large, whole and sharp, as one number."""

from __future__ import annotations

import math

import cv2
import numpy as np
from jaxtyping import UInt8

from remind_jax.tracks import Tracks

# Masks of detectors end up to a few pixels before the frame does.
_BORDER_SHARE = 0.005
# What a view loses that the border of the frame cuts off.
_CUT_OFF = 0.25
# Sharpness is compared at one size, about that at which views are shown.
_COMPARED_PX = 112
# Of a picture without any contrast, in gray levels: the size decides alone.
_LEAST_CONTRAST = 0.1


def view_quality(image: UInt8[np.ndarray, "H W 3"] | None, tracks: Tracks, row: int) -> float:
    """Higher is better; comparable between views of one object in one run.

    Args:
      image: The frame, RGB, at the size of the tracks; without it only size and border count.
      tracks: Its detections.
      row: The one to judge.
    """
    size_px = math.sqrt(max(float(tracks.areas[row]), 0.0))
    whole = _CUT_OFF if touches_border(tracks, row) else 1.0
    return whole * size_px * math.sqrt(_contrast(image, tracks.boxes[row]))


def touches_border(tracks: Tracks, row: int) -> bool:
    """Whether the border of the frame may cut the object off."""
    height, width = tracks.frame_size
    near = max(1.0, _BORDER_SHARE * max(height, width))
    left, top, right, bottom = tracks.boxes[row]
    return bool(min(left, top, width - right, height - bottom) < near)


def _contrast(image: UInt8[np.ndarray, "H W 3"] | None, box: np.ndarray) -> float:
    """Deviation of the Laplacian in the box, in gray levels: small where it is blurred."""
    if image is None:
        return _LEAST_CONTRAST
    left, top, right, bottom = (max(0, round(float(side))) for side in box)
    region = image[top:bottom, left:right]
    if not region.size:
        return _LEAST_CONTRAST
    gray = cv2.cvtColor(np.ascontiguousarray(region), cv2.COLOR_RGB2GRAY)
    scale = _COMPARED_PX / max(gray.shape)
    size = tuple(max(1, round(scale * side)) for side in gray.shape[::-1])
    method = cv2.INTER_AREA if scale < 1 else cv2.INTER_LINEAR
    compared = cv2.resize(gray, size, interpolation=method)
    return max(float(cv2.Laplacian(compared, cv2.CV_32F).std()), _LEAST_CONTRAST)
