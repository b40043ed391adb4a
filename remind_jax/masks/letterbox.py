"""A frame scaled into a network's input with its aspect kept and gray bars around it.

Coordinates are edge coordinates: pixel `i` spans `[i, i + 1]`, its center is at `i + 0.5`. Scaling
rounds to whole pixels, so the two axes have slightly different factors; using the true factor of
each axis and whole-pixel bars makes the way back exact.
"""

from __future__ import annotations

import dataclasses

import cv2
import numpy as np
from jaxtyping import Float, UInt8

GRAY = 114  # what YOLO networks see around images in training


@dataclasses.dataclass(frozen=True)
class Letterbox:
    """Where a frame lies in the input; sizes are (height, width) in pixels."""

    frame_size: tuple[int, int]
    input_size: tuple[int, int]
    scaled_size: tuple[int, int]  # of the frame inside the input
    top_px: int  # height of the bar above; an odd pixel goes below
    left_px: int  # width of the bar on the left; an odd pixel goes right

    @classmethod
    def fit(cls, frame_size: tuple[int, int], input_size: tuple[int, int]) -> Letterbox:
        """Places the frame as large as it fits, in the middle."""
        ratio = min(input_size[0] / frame_size[0], input_size[1] / frame_size[1])
        height, width = (
            min(max(1, round(side * ratio)), limit)
            for side, limit in zip(frame_size, input_size, strict=True)
        )
        top, left = (input_size[0] - height) // 2, (input_size[1] - width) // 2
        return cls(frame_size, input_size, (height, width), top, left)

    def apply(self, image: UInt8[np.ndarray, "h w 3"]) -> UInt8[np.ndarray, "H W 3"]:
        """The network's input image."""
        height, width = self.scaled_size
        if self.scaled_size != self.frame_size:
            image = cv2.resize(image, (width, height), interpolation=cv2.INTER_LINEAR)
        canvas = np.full((*self.input_size, image.shape[2]), GRAY, np.uint8)
        canvas[self._window] = image
        return canvas

    def boxes_to_frame(self, boxes: Float[np.ndarray, "N 4"]) -> Float[np.ndarray, "N 4"]:
        """Boxes (x0, y0, x1, y1) of the input in coordinates of the frame, not clipped."""
        height, width = np.divide(self.scaled_size, self.frame_size)
        return (boxes - [self.left_px, self.top_px] * 2) / [width, height, width, height]

    def plane_to_frame(self, plane: Float[np.ndarray, "H W"]) -> Float[np.ndarray, "h w"]:
        """A map over the input, cut to the frame and resampled bilinearly at its pixel centers."""
        height, width = self.frame_size
        inside = plane[self._window]
        if self.scaled_size == self.frame_size:
            return inside
        return cv2.resize(inside, (width, height), interpolation=cv2.INTER_LINEAR)

    @property
    def _window(self) -> tuple[slice, slice]:
        height, width = self.scaled_size
        rows = slice(self.top_px, self.top_px + height)
        return rows, slice(self.left_px, self.left_px + width)
