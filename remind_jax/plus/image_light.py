"""How the light on the whole image changed, which is undone before objects are described (host).

Rule: method_plus.md#image-light. A lamp that is switched on and a camera that measures its white
anew change the colors of everything, at once or slowly. Where the image goes on, pixels tell how.
"""

from __future__ import annotations

import dataclasses
import functools
from typing import Any

import cv2
import numpy as np
from jaxtyping import Bool, Float, UInt8

from remind_jax.plus.image_motion import reduced_size, scale_motion
from remind_jax.plus.observation import Motion

COMPARED_AREA_PX = 96 * 72  # images are compared at this size, whatever that of the frame
LEAST_SCORE = 0.2  # of the motion by which pixels are compared
SENSOR_OFFSET = 4.0  # gray levels; keeps noise in the dark from looking like color
DARK, BRIGHT = 12, 245  # gray levels beyond which colors are not compared
LEAST_PIXELS = 200
WINDOW_PX = 13  # around a pixel, at the size compared
LEAST_CORRELATION = 0.7
NOISE = 3e-4  # variance of logarithms of brightness that says nothing
# An image is compared with later ones for so many frames, or until they moved so far.
COMPARED_FRAMES = 15
COMPARED_SHIFT = 0.03  # of the width
# Natural logarithms of color ratios.
JUMP = 0.08  # smaller changes are not undone before they add up to this
AGREEMENT = 0.1  # pixels agree on a change within this
SAME = 0.03  # light within this is as it was at first
AGREEING_SHARE = 0.6  # of the pixels that must agree
FIT_ROUNDS = 3
CONTRAST_PRIOR = 0.05**2  # variance of color ratios per pixel that stands for contrast as it was
CONTRAST_RANGE = 0.5, 2.0
_NOTHING = np.zeros((0, 0, 3), np.uint8)
_LOGARITHMS = np.log(np.arange(256, dtype=np.float32) + np.float32(SENSOR_OFFSET))


@dataclasses.dataclass(frozen=True)
class Tone:
    """Colors by others: logarithms are `contrast * logarithm + offset`, channel by channel."""

    contrast: float = 1.0
    offset: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def after(self, change: Tone) -> Tone:
        """The same of colors that were changed: undoes that first."""
        contrast = self.contrast / change.contrast
        offset = np.subtract(self.offset, np.multiply(contrast, change.offset))
        return Tone(contrast, tuple(offset.tolist()))

    def tint_from(self, other: Tone) -> float:
        """How far what they make of gray is apart, as the logarithm of a ratio to green."""
        off = np.subtract(self.offset, other.offset)
        return float(np.abs(off - off[1]).max())

    def is_none(self) -> bool:
        """Whether it changes colors by next to nothing."""
        return abs(self.contrast - 1.0) < SAME and self.tint_from(Tone()) < SAME

    def apply(self, image: UInt8[np.ndarray, "H W 3"]) -> UInt8[np.ndarray, "H W 3"]:
        """The image with these colors."""
        colors = np.exp(self.contrast * _LOGARITHMS[:, None] + self.offset) - SENSOR_OFFSET
        table = np.clip(np.round(colors), 0, 255).astype(np.uint8)
        return cv2.LUT(image, table[None])


class ImageLight:
    """Images of one stream in the light of its first one, as far as it is seen to change."""

    def __init__(self) -> None:
        """Has seen no image."""
        self._reference = _NOTHING  # reduced; changes are told from it
        self._moved = np.eye(3)  # since then, in pixels of the image
        self._age = 0  # frames since then
        self._estimate = Tone()  # that brings what was last compared into the first light
        self._tone = Tone()  # that images are brought into the first light by

    def follow(self, image: UInt8[np.ndarray, "H W 3"] | None, motion: Motion) -> None:
        """Takes the next RGB image, None where there is none, and its motion from the last one."""
        if image is None:
            self._refer_to(_NOTHING)
            return
        height, width = reduced_size(image, COMPARED_AREA_PX)
        # Means of four pixels each: to read all of them takes longer than all that follows.
        some = cv2.resize(image, (2 * width, 2 * height), interpolation=cv2.INTER_NEAREST)
        now = cv2.resize(some, (width, height), interpolation=cv2.INTER_AREA)
        if self._reference.shape != now.shape or motion.score < LEAST_SCORE:
            self._refer_to(now)
            return
        self._moved = np.vstack([motion.matrix, (0, 0, 1)]) @ self._moved
        self._age += 1
        shift = np.abs(self._moved[:2, 2]).max() / image.shape[1]
        is_due = self._age >= COMPARED_FRAMES or shift >= COMPARED_SHIFT
        scaled = scale_motion(self._moved[:2], (width / image.shape[1], height / image.shape[0]))
        # Black, which is not compared, outside.
        before = cv2.warpAffine(self._reference, scaled, (width, height))
        change = find_change(before, now, JUMP)
        is_jump = change is not None
        if not is_jump and not is_due:
            return
        change = change or find_change(before, now, 0.0)
        self._refer_to(now)
        if change is None:
            return
        self._estimate = self._estimate.after(change)
        if is_jump or self._estimate.tint_from(self._tone) > JUMP:
            # Light that is as it was leaves images as they are, however often it changed.
            self._tone = Tone() if self._estimate.is_none() else self._estimate

    def steady(self, image: UInt8[np.ndarray, "H W 3"]) -> UInt8[np.ndarray, "H W 3"]:
        """The image that was followed last, in the first light."""
        return image if self._tone == Tone() else self._tone.apply(image)

    def _refer_to(self, image: UInt8[np.ndarray, "h w 3"]) -> None:
        """Compares later images with this one."""
        self._reference, self._moved, self._age = image, np.eye(3), 0


def find_change(
    before: UInt8[np.ndarray, "h w 3"], now: UInt8[np.ndarray, "h w 3"], least: float = JUMP
) -> Tone | None:
    """How the colors of one image became those of another that shows the same in places.

    Told from ratios of red and blue to green, which shadows and the distance to a lamp hardly
    change; None where no median changed by `least`, too few pixels show the same, or these do not
    agree.
    """
    channels: list[Any] = [*cv2.split(before), *cv2.split(now)]
    compared = functools.reduce(cv2.min, channels) > DARK
    compared &= functools.reduce(cv2.max, channels) < BRIGHT
    red, green, blue, *new = (cv2.LUT(channel, _LOGARITHMS) for channel in channels)
    tints = (red - green, new[0] - new[1]), (blue - green, new[2] - new[1])
    # Light mostly stays, which all pixels tell sooner than those that are seen to be the same.
    if not _changed(tints, compared, least):
        return None
    same = compared & find_same(green, new[1], compared)
    if not _changed(tints, same, least):
        return None
    old_tint, new_tint = (np.stack([pair[k][same] for pair in tints]) for k in (0, 1))
    contrast, tint = 1.0, np.median(new_tint - old_tint, axis=1, keepdims=True)
    # Small changes add up: contrast, that noise makes less each time, is fitted to large ones only.
    for _ in range(FIT_ROUNDS if np.abs(tint).max() > JUMP else 0):
        kept = np.abs(new_tint - contrast * old_tint - tint).max(axis=0) < 2 * AGREEMENT
        if np.count_nonzero(kept) < LEAST_PIXELS:
            return None
        x, y = old_tint[:, kept], new_tint[:, kept]
        off_x, off_y = (values - values.mean(axis=1, keepdims=True) for values in (x, y))
        prior = CONTRAST_PRIOR * x.shape[1]
        slope = (np.sum(off_x * off_y) + prior) / (np.sum(off_x**2) + prior)
        contrast = float(np.clip(slope, *CONTRAST_RANGE))
        tint = np.median(y - contrast * x, axis=1, keepdims=True)
    off = np.abs(new_tint - contrast * old_tint - tint).max(axis=0)
    if np.mean(off < AGREEMENT) < AGREEING_SHARE:
        return None
    level = float(np.median((new[1] - contrast * green)[same]))
    return Tone(contrast, (level + float(tint[0, 0]), level, level + float(tint[1, 0])))


def _changed(tints: Any, pixels: Bool[np.ndarray, "h w"], least: float) -> bool:
    """Whether there are enough of these pixels, and the median of a tint changed by so much."""
    if np.count_nonzero(pixels) < LEAST_PIXELS:
        return False
    return max(abs(np.median((new - old)[pixels])) for old, new in tints) >= least


def find_same(
    before: Float[np.ndarray, "h w"],
    now: Float[np.ndarray, "h w"],
    compared: Bool[np.ndarray, "h w"],
) -> Bool[np.ndarray, "h w"]:
    """Where two images show the same in whatever light: what is around a pixel correlates.

    Takes logarithms of brightness. What has no structure is nowhere the same: through a doorway,
    the wall of one room takes the place of that of the other.
    """
    inside = compared.astype(np.float32)

    def mean(values: np.ndarray) -> np.ndarray:
        return cv2.blur(values * inside, (WINDOW_PX, WINDOW_PX)) / weight

    weight = np.maximum(cv2.blur(inside, (WINDOW_PX, WINDOW_PX)), 1.0 / WINDOW_PX**2)
    x, y = before - mean(before), now - mean(now)
    spread = np.sqrt((mean(x * x) + NOISE) * (mean(y * y) + NOISE))
    return mean(x * y) > LEAST_CORRELATION * spread
