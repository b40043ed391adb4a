"""Picture files: looked at by Pillow before memory is taken, decoded by OpenCV.

OpenCV takes memory for any size that a header claims, fills what is missing of a JPEG with gray,
and expands palettes and gray values of fewer than 8 bits, which destroys the numbers of instances.
"""

from __future__ import annotations

import io
import re
import warnings
from typing import TYPE_CHECKING

import cv2
import numpy as np
from jaxtyping import Integer, Num, UInt8

from remind_jax.errors import UnreadableFrame, first_line
from remind_jax.files.limits import MAX_PICTURE_PIXELS, MAX_SIDE_PX

if TYPE_CHECKING:
    from PIL.Image import Image

TIMES_NAME = "times.txt"  # in a folder of pictures: seconds of every one, one a line
IMAGE_SUFFIXES = (".jpg", ".jpeg", ".png", ".bmp", ".webp", ".tif", ".tiff")
VOID = 255  # in 8-bit instance maps of DAVIS: neither an object nor nothing
_KINDS = ("PNG", "JPEG", "WEBP", "BMP", "TIFF")
_MAX_SCANS = 100  # of a JPEG that gets sharper, which has some ten; each takes as long as a picture
_NO_PICTURE_OF_ITS_OWN = 0b101  # kinds of TIFF pages: a smaller copy, a mask
_KIND_OF_PAGE = 254  # tag of TIFF
_NUMBERS = ("I", "F")  # samples of floats, of over 16 bits, or with a sign


def natural_key(name: str) -> tuple[tuple[int, int, str], ...]:
    """Sorts `frame_9` before `frame_10`, as pictures of a folder follow each other."""
    parts = re.split(r"(\d+)", name)
    return tuple((0, int(p), p) if p.isdecimal() else (1, 0, p.lower()) for p in parts if p)


def check_picture(data: bytes) -> Image:
    """Opens a picture without decoding it; its `size` is width and height.

    Raises:
      UnreadableFrame: If it is no picture of a known kind, without pixels, too large, cut off, an
        animation, or of several pages.
    """
    # It takes long, and a live tracker reads no file.
    from PIL import Image, UnidentifiedImageError

    if not data:
        raise UnreadableFrame("the file is empty")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of sizes that are compared here
        try:
            picture = Image.open(io.BytesIO(data), formats=_KINDS)
            width, height = picture.size
            if max(width, height) > MAX_SIDE_PX or not 0 < width * height <= MAX_PICTURE_PIXELS:
                raise ValueError(f"{width}x{height} pixels, at most {MAX_PICTURE_PIXELS} are read")
            _check_pages(picture)
            _check_end(picture, data)
        except Exception as error:  # of somebody else's code
            why = "" if isinstance(error, UnidentifiedImageError) else f" ({first_line(error)})"
            raise UnreadableFrame(
                f"it is damaged, cut off, or no picture that is read{why}; give PNG, JPEG, WebP, "
                "BMP or TIFF"
            ) from error
    return picture


def decode_image(data: bytes) -> UInt8[np.ndarray, "H W 3"]:
    """Decodes a picture to RGB, 8 bits, turned upright as its EXIF entry says.

    Raises:
      UnreadableFrame: If it is damaged or too large, or its samples are no brightness.
    """
    if (mode := check_picture(data).mode) in _NUMBERS:
        raise UnreadableFrame(
            f"its samples are numbers of kind {mode}; give whole numbers of 8 or 16 bits"
        )
    pixels = _decode(data, cv2.IMREAD_COLOR)
    return cv2.cvtColor(pixels, cv2.COLOR_BGR2RGB, dst=pixels)


def read_label_map(data: bytes) -> Integer[np.ndarray, "H W"]:
    """Decodes an instance map: the number of a pixel is the instance it belongs to.

    Read are gray PNG of 1 to 16 bits, palettes, and other gray images.

    Raises:
      UnreadableFrame: If it is damaged, too large, or a color picture without a palette.
    """
    picture = check_picture(data)
    if picture.mode == "P":
        from PIL import Image

        try:
            return np.asarray(Image.open(io.BytesIO(data)))
        except (OSError, ValueError, SyntaxError) as error:
            raise UnreadableFrame(f"it is damaged ({first_line(error)})") from error
    labels = _decode(data, cv2.IMREAD_UNCHANGED)
    if labels.ndim == 3:
        colors = labels[..., :3]
        if (colors != colors[..., :1]).any():
            raise UnreadableFrame(
                "it is a color picture; instance maps are gray (8 or 16 bits) or have a palette"
            )
        labels = colors[..., 0]
    if labels.dtype.kind not in "ui":
        raise UnreadableFrame(f"its pixels are {labels.dtype}; instance maps hold whole numbers")
    depth = data[24] if picture.format == "PNG" else 8
    return labels // (255 // (2**depth - 1)) if depth < 8 else labels


def _decode(data: bytes, mode: int) -> Num[np.ndarray, "H W *C"]:
    try:
        pixels = cv2.imdecode(np.frombuffer(data, np.uint8), mode)
    except (cv2.error, MemoryError) as error:
        raise UnreadableFrame(f"it cannot be decoded ({first_line(error)})") from error
    if pixels is None:
        raise UnreadableFrame("it is cut off, damaged or no image")
    return pixels


def _check_pages(picture: Image) -> None:
    """Refuses several pictures in one file; MPO are JPEGs with previews behind them."""
    if picture.format == "MPO":
        return
    for page in range(1, getattr(picture, "n_frames", 1)):
        picture.seek(page)
        tags = getattr(picture, "tag_v2", {})
        if not tags.get(_KIND_OF_PAGE, 0) & _NO_PICTURE_OF_ITS_OWN:
            raise ValueError("an animation, or several pages")
    picture.seek(0)


def _check_end(picture: Image, data: bytes) -> None:
    """Refuses what is cut off where OpenCV would not."""
    if picture.format == "PNG":
        picture.verify()
    elif picture.format in ("JPEG", "MPO"):
        if picture.info.get("progressive") and data.count(b"\xff\xda") > _MAX_SCANS:
            raise ValueError(f"a JPEG of over {_MAX_SCANS} scans")
        if data.endswith(b"\xff\xd9"):
            return
        from PIL.Image import open as open_again

        small = open_again(io.BytesIO(data), formats=("JPEG",))
        small.draft("L", (1, 1))  # an eighth of the size, in a third of the time
        small.load()
