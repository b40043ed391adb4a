"""What all pictures of a run share: colors of identities, text, and images of one size."""

from __future__ import annotations

import colorsys
import functools
from typing import Any

import cv2
import numpy as np
from jaxtyping import UInt8

Color = tuple[int, int, int]  # red, green, blue, 0-255

_GOLDEN_RATIO = 0.618033988749895
# Saturation and value change from id to id, so that hues that come close still differ.
_TONES = ((0.72, 0.98), (0.85, 0.80), (0.50, 1.00))

NO_IMAGE_GRAY = 72  # level where there is no image

AMBIGUOUS: Color = (255, 255, 255)
PROVISIONAL: Color = (200, 205, 212)
DISCARDED: Color = (128, 128, 128)


def identity_color(object_id: int) -> Color:
    """The color of an identity; neighbors in number are far apart in hue."""
    saturation, value = _TONES[object_id % len(_TONES)]
    hue = (0.58 + object_id * _GOLDEN_RATIO) % 1.0
    red, green, blue = colorsys.hsv_to_rgb(hue, saturation, value)
    return round(255 * red), round(255 * green), round(255 * blue)


def ink_on(background: Color) -> Color:
    """Near-black or white, whichever stands out more on the background."""
    red, green, blue = ((channel / 255) ** 2.2 for channel in background)
    luminance = 0.2126 * red + 0.7152 * green + 0.0722 * blue
    return (16, 18, 22) if luminance > 0.18 else (255, 255, 255)


def to_hex(color: Color) -> str:
    """The color as CSS writes it."""
    return "#{:02x}{:02x}{:02x}".format(*color)


def fit_image(image: UInt8[np.ndarray, "H W 3"], height: int, width: int) -> np.ndarray:
    """The image at the given size in pixels, resized only if it has another one."""
    if image.shape[:2] == (height, width):
        return image
    return cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA)


def encode_jpeg(image: UInt8[np.ndarray, "H W 3"], quality: int) -> bytes:
    """An RGB image as JPEG; quality from 0 to 100."""
    options = [cv2.IMWRITE_JPEG_QUALITY, quality]
    return cv2.imencode(".jpg", cv2.cvtColor(image, cv2.COLOR_RGB2BGR), options)[1].tobytes()


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


def _stroke_scale(size_px: int) -> float:
    return 0.72 * size_px / _STROKE_CAPITAL_PX


def _plain(text: str) -> str:
    return text.encode("ascii", "replace").decode("ascii")
