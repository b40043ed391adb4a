"""Colors of identities: the same in the overlay, the timeline, the gallery and the report."""

from __future__ import annotations

import colorsys

Color = tuple[int, int, int]  # red, green, blue, 0-255

_GOLDEN_RATIO = 0.618033988749895
# Saturation and value change from id to id, so that hues that come close still differ.
_TONES = ((0.72, 0.98), (0.85, 0.80), (0.50, 1.00))

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
