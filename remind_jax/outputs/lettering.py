"""Text on images: OpenCV 5's outline font where it is there, the stroke font of 4 otherwise."""

from __future__ import annotations

import functools
from typing import Any

import cv2
import numpy as np
from jaxtyping import UInt8

from remind_jax.outputs.palette import Color

_WEIGHT = 500
# Of the stroke font: capital height in pixels at scale 1.
_STROKE_CAPITAL_PX = 22.0


@functools.cache
def _font() -> Any:
    """The outline font, or None before OpenCV 5."""
    return cv2.FontFace("sans") if hasattr(cv2, "FontFace") else None


def text_width(text: str, size_px: int) -> int:
    """Width in pixels of one line of text of this size."""
    if (font := _font()) is not None:
        # The first argument is the size of an image that would clip the text; none does here.
        rectangle: Any = cv2.getTextSize((1 << 14, 1 << 14), text, (0, 0), font, size_px, _WEIGHT)
        return int(rectangle[0] + rectangle[2])
    (width, _), _ = cv2.getTextSize(
        _plain(text), cv2.FONT_HERSHEY_SIMPLEX, _stroke_scale(size_px), 1
    )
    return int(width)


def put_text(
    image: UInt8[np.ndarray, "H W 3"], text: str, x: int, baseline: int, size_px: int, ink: Color
) -> None:
    """Writes one line of text onto the image in place, starting at `x` on `baseline`."""
    if (font := _font()) is not None:
        cv2.putText(image, text, (x, baseline), ink, font, size_px, _WEIGHT)
        return
    cv2.putText(
        image,
        _plain(text),
        (x, baseline),
        cv2.FONT_HERSHEY_SIMPLEX,
        _stroke_scale(size_px),
        ink,
        1,
        cv2.LINE_AA,
    )


def shorten(text: str, size_px: int, max_width_px: int, tail: str = "") -> str:
    """The text and its tail, or as much of the text as fits before `...` and the whole tail."""
    if text_width(text + tail, size_px) <= max_width_px:
        return text + tail
    while text and text_width(f"{text}...{tail}", size_px) > max_width_px:
        text = text[:-1]
    return f"{text}...{tail}"


def _stroke_scale(size_px: int) -> float:
    return 0.72 * size_px / _STROKE_CAPITAL_PX


def _plain(text: str) -> str:
    return text.encode("ascii", "replace").decode("ascii")
