"""From light to a picture: exposure that lags behind, lens, shutter, noise."""

from __future__ import annotations

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from remind_jax.synthetic.scene import Sensor

_LAMP_COLOR = np.array([1.06, 1.0, 0.9], np.float32)
_WINDOW_COLOR = np.array([0.86, 0.97, 1.14], np.float32)
_KEY = 0.3  # mean linear brightness that the exposure aims at
_COMPENSATION = 0.3  # 1: a dark room would end up as bright as a lit one
_GAIN_LIMITS = (0.35, 3.5)
_LENS_BLUR_PX = 0.62  # at 640 pixels width
_NOISE_POOL = 3


class Developer:
    """Turns color and light images into pictures; holds what is the same for all frames."""

    def __init__(self, sensor: Sensor, seed: int):
        self._sensor = sensor
        height, width = sensor.height_px, sensor.width_px
        y, x = np.mgrid[0:height, 0:width].astype(np.float32)
        radius2 = ((x / width - 0.5) ** 2 + (y / height - 0.5) ** 2) * 2
        self._vignette = (1 - sensor.vignetting * radius2**1.2).astype(np.float32)[..., None]
        # Noise is cut from a few large sheets: fresh draws would double the time of a frame.
        rng = np.random.default_rng([seed, 5])
        shape = (_NOISE_POOL, height + 64, width + 64, 3)
        self._sheets = rng.standard_normal(shape, dtype=np.float32)
        self._seed = seed

    def develop(
        self,
        color: UInt8[np.ndarray, "H W 3"],
        light: Float[np.ndarray, "H W 2"],
        lamp_level: float,
        window_level: float,
        last_gain: float | None,
        motion_px: tuple[float, float],
        frame: int,
    ) -> tuple[UInt8[np.ndarray, "H W 3"], float]:
        """The picture of one frame and the gain that it was taken with.

        Args:
          color: Surface colors as display values (gamma 2).
          light: Light from lamps at full level and from windows, per pixel.
          lamp_level: Level of the lamps.
          window_level: Level of the windows.
          last_gain: Gain of the last frame, which exposure follows; None before the first.
          motion_px: How far the image moves per frame, for the blur.
          frame: Number of the frame; picks the noise.
        """
        mixed = light @ np.stack([lamp_level * _LAMP_COLOR, window_level * _WINDOW_COLOR])
        small = (slice(None, None, 8), slice(None, None, 8))
        # Highlights saturate in the meter as in the picture.
        radiance = (color[small].astype(np.float32) / 255) ** 2 * mixed[small]
        gain = self._meter(float(np.minimum(radiance, 1.0).mean()), last_gain)
        mixed *= gain * self._vignette
        picture = color.astype(np.float32) * np.sqrt(mixed, out=mixed)
        picture = self._blur(picture, motion_px, slow_shutter=lamp_level < 0.5)
        self._add_noise(picture, gain, frame)
        return np.clip(picture + 0.5, 0, 255).astype(np.uint8), gain

    def _meter(self, mean: float, last_gain: float | None) -> float:
        wanted = (_KEY / max(mean, 1e-5)) ** _COMPENSATION
        wanted = float(np.clip(wanted, *_GAIN_LIMITS))
        if last_gain is None:
            return wanted
        lag = self._sensor.exposure_lag
        return float(np.exp(lag * np.log(last_gain) + (1 - lag) * np.log(wanted)))

    def _blur(
        self, picture: np.ndarray, motion_px: tuple[float, float], slow_shutter: bool
    ) -> np.ndarray:
        """Lens blur, and a smear along the motion; a camera opens longer in the dark."""
        lens_px = _LENS_BLUR_PX * max(self._sensor.width_px / 640, 0.5)
        picture = cv2.GaussianBlur(picture, (3, 3), lens_px)
        share = self._sensor.motion_blur * (1.5 if slow_shutter else 1.0)
        smear = np.array(motion_px) * share
        length = float(np.hypot(*smear))
        if length < 1.0:
            return picture
        half = int(np.ceil(length / 2))
        kernel = np.zeros((2 * half + 1, 2 * half + 1), np.float32)
        steps = np.linspace(-0.5, 0.5, 4 * half + 1)[:, None] * smear + half
        for x, y in np.rint(steps).astype(int):
            kernel[y, x] += 1
        return cv2.filter2D(picture, -1, kernel / kernel.sum(), borderType=cv2.BORDER_REPLICATE)

    def _add_noise(self, picture: np.ndarray, gain: float, frame: int) -> None:
        if self._sensor.noise == 0:
            return
        rng = np.random.default_rng([self._seed, 6, frame])
        sheet = self._sheets[int(rng.integers(_NOISE_POOL))]
        top, left = rng.integers(0, 64, 2)
        height, width = picture.shape[:2]
        strength = np.float32(self._sensor.noise * np.sqrt(max(gain, 0.5)))
        picture += strength * sheet[top : top + height, left : left + width]
