"""Instance maps from image files: the number of a pixel is the instance it belongs to.

OpenCV expands palette PNGs to colors and stretches gray values of fewer than 8 bits, which
destroys the numbers; FFmpeg (PyAV) keeps palette indices of every depth.
"""

from __future__ import annotations

import io

import cv2
import numpy as np
from jaxtyping import Integer

from remind_jax.sources.image_folder import decode_pixels
from remind_jax.sources.picture_file import check_picture
from remind_jax.sources.source import UnreadableFrame

PNG_SIGNATURE = b"\x89PNG\r\n\x1a\n"
GRAY, PALETTE = 0, 3  # PNG color types


def read_label_map(data: bytes) -> Integer[np.ndarray, "H W"]:
    """Decodes an instance map: gray PNG of 1 to 16 bits, palette PNG, or another gray image.

    Raises:
      UnreadableFrame: If it is damaged, too large, or a color picture without a palette.
    """
    if data[:8] == PNG_SIGNATURE and len(data) >= 33:
        check_picture(data)
        depth, color_type = data[24:26]
        if color_type == PALETTE:
            return _read_palette_indices(data)
        if color_type == GRAY and depth < 8:
            return _decode(data) // (255 // (2**depth - 1))
    return _decode(data)


def _read_palette_indices(data: bytes) -> Integer[np.ndarray, "H W"]:
    import av  # takes long, and a live tracker reads no file
    from av.error import FFmpegError

    try:
        with av.open(io.BytesIO(data), mode="r", format="png_pipe") as container:
            frame = next(container.decode(video=0))
    except (FFmpegError, StopIteration) as error:
        raise UnreadableFrame(f"it is a damaged palette PNG ({error})") from error
    plane = frame.planes[0]
    if frame.format.name != "pal8":
        raise UnreadableFrame(f"its palette was decoded as {frame.format.name}, indices are lost")
    indices = np.frombuffer(memoryview(plane), np.uint8).reshape(-1, plane.line_size)
    return indices[: frame.height, : frame.width].copy()


def _decode(data: bytes) -> Integer[np.ndarray, "H W"]:
    labels = decode_pixels(data, cv2.IMREAD_UNCHANGED)
    if labels.ndim == 3:
        colors = labels[..., :3]
        if (colors != colors[..., :1]).any():
            raise UnreadableFrame(
                "it is a color picture; instance maps are gray (8 or 16 bits) or have a palette"
            )
        labels = colors[..., 0]
    if labels.dtype.kind not in "ui":
        raise UnreadableFrame(f"its pixels are {labels.dtype}; instance maps hold whole numbers")
    return labels
