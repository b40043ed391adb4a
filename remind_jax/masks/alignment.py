"""Brings a frame and its masks to the size that the tracker works at (method.md#frame-size)."""

from __future__ import annotations

import dataclasses

import cv2
import numpy as np
from jaxtyping import Bool, UInt8

from remind_jax.crops import Crops, nearest_places
from remind_jax.errors import UnreadableFrame


@dataclasses.dataclass(frozen=True)
class Alignment:
    """How pixels of a frame become pixels of the tracker: scaled, then cropped to patches."""

    scaled_size: tuple[int, int]  # height, width in pixels
    top: int  # first row of the crop
    left: int
    size: tuple[int, int]  # height, width of the crop, multiples of the patch

    @classmethod
    def fit(
        cls, frame_size: tuple[int, int], patch_px: int, *, max_width_px: int, center_crop: bool
    ) -> Alignment:
        """Plans the alignment of frames of one size.

        Args:
          max_width_px: Wider frames are scaled down to this width.
          center_crop: Crop in the middle, else at the top left.

        Raises:
          UnreadableFrame: If the frame is smaller than a patch.
        """
        height, width = frame_size
        if width > max_width_px:
            height, width = round(height * (max_width_px / width)), max_width_px
        rows, columns = patch_px * (height // patch_px), patch_px * (width // patch_px)
        if not rows or not columns:
            scaled = "" if (height, width) == frame_size else f", scaled to {width}x{height},"
            raise UnreadableFrame(
                f"a frame of {frame_size[1]}x{frame_size[0]} pixels{scaled} is smaller than one "
                f"patch; both sides must be at least {patch_px} pixels"
            )
        top = (height - rows) // 2 if center_crop else 0
        left = (width - columns) // 2 if center_crop else 0
        return cls((height, width), top, left, (rows, columns))

    def align_image(self, image: UInt8[np.ndarray, "H W 3"]) -> UInt8[np.ndarray, "h w 3"]:
        """The image at the tracker's size."""
        if image.shape[:2] != self.scaled_size:
            image = cv2.resize(image, self.scaled_size[::-1], interpolation=cv2.INTER_AREA)
        return image[self.top : self.top + self.size[0], self.left : self.left + self.size[1]]

    def align_masks(self, masks: Bool[np.ndarray, "N H W"] | Crops) -> Crops:
        """The masks at the tracker's size, by nearest neighbor."""
        crops = Crops.of(masks)
        if (crops.size, (self.top, self.left), crops.size) == (self.scaled_size, (0, 0), self.size):
            return crops
        # Where every row and column of the result comes from is the same for all masks.
        from_row, from_column = map(nearest_places, crops.size, self.scaled_size)
        return crops.sampled(
            from_row[self.top : self.top + self.size[0]],
            from_column[self.left : self.left + self.size[1]],
        )
