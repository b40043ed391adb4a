"""Pictures and instance maps of ROS messages as arrays."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from jaxtyping import Int, UInt8

from remind_jax.errors import SourceError, first_line

# Kind of a pixel, its channels, and how OpenCV turns it into RGB.
_PICTURES: dict[str, tuple[type, int, int | None]] = {
    "rgb8": (np.uint8, 3, None),
    "8UC3": (np.uint8, 3, cv2.COLOR_BGR2RGB),
    "bgr8": (np.uint8, 3, cv2.COLOR_BGR2RGB),
    "rgba8": (np.uint8, 4, cv2.COLOR_RGBA2RGB),
    "bgra8": (np.uint8, 4, cv2.COLOR_BGRA2RGB),
    "8UC4": (np.uint8, 4, cv2.COLOR_BGRA2RGB),
    "mono8": (np.uint8, 1, cv2.COLOR_GRAY2RGB),
    "8UC1": (np.uint8, 1, cv2.COLOR_GRAY2RGB),
    "uyvy": (np.uint8, 2, cv2.COLOR_YUV2RGB_UYVY),
    "yuv422": (np.uint8, 2, cv2.COLOR_YUV2RGB_UYVY),
    "yuyv": (np.uint8, 2, cv2.COLOR_YUV2RGB_YUYV),
    "yuv422_yuy2": (np.uint8, 2, cv2.COLOR_YUV2RGB_YUYV),
    # OpenCV names a mosaic by the second row's second and third pixel.
    "bayer_rggb8": (np.uint8, 1, cv2.COLOR_BayerBG2RGB),
    "bayer_bggr8": (np.uint8, 1, cv2.COLOR_BayerRG2RGB),
    "bayer_gbrg8": (np.uint8, 1, cv2.COLOR_BayerGR2RGB),
    "bayer_grbg8": (np.uint8, 1, cv2.COLOR_BayerGB2RGB),
}
_MAPS = {
    "mono8": np.uint8,
    "8UC1": np.uint8,
    "mono16": np.uint16,
    "16UC1": np.uint16,
    "16SC1": np.int16,
    "32SC1": np.int32,
}


def read_picture(message: Any) -> UInt8[np.ndarray, "H W 3"]:
    """RGB of a `sensor_msgs/Image` or `sensor_msgs/CompressedImage`.

    Raises:
      SourceError: If the encoding is not one of a color or gray picture, or the data is damaged.
    """
    try:
        return _decode(message)
    except cv2.error as error:
        kind = message.encoding if hasattr(message, "encoding") else message.format
        raise SourceError(
            f"an image ('{kind}') cannot be converted ({first_line(error)}); send rgb8 or JPEG"
        ) from error


def _decode(message: Any) -> UInt8[np.ndarray, "H W 3"]:
    if not hasattr(message, "encoding"):
        data = np.frombuffer(memoryview(message.data), np.uint8)
        flags = cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION
        picture = cv2.imdecode(data, flags) if data.size else None
        if picture is None:
            raise SourceError(
                f"a compressed image of {data.size} bytes ('{message.format}') cannot be decoded; "
                "send JPEG or PNG"
            )
        return cv2.cvtColor(picture, cv2.COLOR_BGR2RGB)
    kind, channels, conversion = _look_up(_PICTURES, message.encoding, "an image")
    pixels = _read_rows(message, np.dtype(kind), channels)
    return pixels.copy() if conversion is None else cv2.cvtColor(pixels, conversion)


def read_instance_map(message: Any) -> Int[np.ndarray, "H W"]:
    """Number of the instance at each pixel of a `sensor_msgs/Image`; 0 where there is none.

    Raises:
      SourceError: If the encoding is not one of whole numbers, or the data is damaged.
    """
    kind = _look_up(_MAPS, message.encoding, "an instance map")
    return _read_rows(message, np.dtype(kind), 1).astype(np.int64)


def _look_up(known: dict[str, Any], encoding: str, what: str) -> Any:
    if encoding not in known:
        raise SourceError(
            f"{what} has the encoding '{encoding}'; send one of {', '.join(sorted(known))}"
        )
    return known[encoding]


def _read_rows(message: Any, kind: np.dtype, channels: int) -> np.ndarray:
    """Pixels `[H, W]` or `[H, W, channels]`; rows may be followed by bytes that mean nothing."""
    height, width, step = int(message.height), int(message.width), int(message.step)
    row_bytes = width * channels * kind.itemsize
    data = np.frombuffer(memoryview(message.data), np.uint8)
    if height < 1 or width < 1 or step < row_bytes or data.size < step * height:
        raise SourceError(
            f"an image of {width}x{height} pixels ('{message.encoding}') has rows of {step} bytes "
            f"and {data.size} bytes in all; needed are {row_bytes} and {step * height}"
        )
    rows = np.ascontiguousarray(data[: step * height].reshape(height, step)[:, :row_bytes])
    order = ">" if message.is_bigendian and kind.itemsize > 1 else "="
    pixels = rows.view(kind.newbyteorder(order)).astype(kind, copy=False)
    return pixels.reshape((height, width) if channels == 1 else (height, width, channels))
