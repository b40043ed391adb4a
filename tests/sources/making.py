"""Small files for the tests of sources."""

import json
import struct
import zlib
from collections.abc import Callable, Sequence
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import cv2
import numpy as np

from remind_jax.frame import Detections
from remind_jax.masks.run_length import encode_masks

SIZE = (32, 48)  # height, width in pixels


def picture(index: int, size: tuple[int, int] = SIZE) -> np.ndarray:
    """RGB; red everywhere, with a green bar that grows by two columns per frame."""
    image = np.full((*size, 3), (200, 30, 30), np.uint8)
    image[:, : 2 * index + 2] = (20, 200, 20)
    return image


def encode_image(suffix: str, image: np.ndarray, options: Sequence[int] = ()) -> bytes:
    """A picture, RGB or gray, as a file holds it; options are those of OpenCV."""
    bgr = cv2.cvtColor(image, cv2.COLOR_RGB2BGR) if image.ndim == 3 else image
    ok, data = cv2.imencode(suffix, bgr, options)
    assert ok
    return data.tobytes()


def write_image(path: Path, image: np.ndarray) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(encode_image(path.suffix, image))


def write_files(folder: Path, files: dict[str, bytes]) -> Path:
    for name, data in files.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(data)
    return folder


def write_images(folder: Path, names: list[str], size: tuple[int, int] = SIZE) -> None:
    for index, name in enumerate(names):
        write_image(folder / name, picture(index, size))


def gray_png(labels: np.ndarray) -> bytes:
    return encode_image(".png", labels)


def png(pixels: np.ndarray, depth: int, color_type: int, num_colors: int = 0) -> bytes:
    """A PNG of numbers of `depth` bits; a palette whose colors differ from the numbers."""
    height, width = pixels.shape
    bits = (pixels[..., None] >> np.arange(depth - 1, -1, -1)) & 1
    rows = np.packbits(bits.reshape(height, width * depth).astype(np.uint8), axis=1)
    raw = b"".join(b"\0" + row.tobytes() for row in rows)
    palette = bytes((31 * i + 7 * c + 5) % 256 for i in range(num_colors) for c in range(3))
    return b"\x89PNG\r\n\x1a\n" + b"".join(
        _chunk(kind, data)
        for kind, data in (
            (b"IHDR", struct.pack(">IIBBBBB", width, height, depth, color_type, 0, 0, 0)),
            (b"PLTE", palette),
            (b"IDAT", zlib.compress(raw)),
            (b"IEND", b""),
        )
        if kind != b"PLTE" or palette
    )


def _chunk(kind: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))


def palette_png(pixels: np.ndarray) -> bytes:
    return png(pixels, 8, color_type=3, num_colors=2**8)


def instance_map(size: tuple[int, int] = SIZE, ids: tuple[int, ...] = (1, 2)) -> np.ndarray:
    """Bars of a quarter of the height, one per id."""
    labels = np.zeros(size, np.uint16 if max(ids) > 255 else np.uint8)
    for row, instance_id in enumerate(ids):
        labels[row * size[0] // 4 : (row + 1) * size[0] // 4, : size[1] // 2] = instance_id
    return labels


def run_lengths(mask: np.ndarray) -> dict[str, Any]:
    """The code of a mask, as JSON holds it."""
    (code,) = encode_masks(mask[None])
    return {"size": list(code["size"]), "counts": code["counts"].decode()}


def write_map(path: Path, ids: tuple[int, ...] = (1, 2)) -> None:
    write_image(path, instance_map(ids=ids))


def write_davis(root: Path, name: str = "room", num: int = 3, metadata: dict | None = None) -> None:
    write_images(root / "JPEGImages" / name, [f"{i:05d}.jpg" for i in range(num)])
    for i in range(num):
        write_map(root / "Annotations" / name / f"{i:05d}.png")
    if metadata is not None:
        (root / "metadata.json").write_text(json.dumps(metadata))


def assert_same_detections(one: Detections, other: Detections) -> None:
    np.testing.assert_array_equal(one.masks, other.masks)
    np.testing.assert_array_equal(one.scores, other.scores)
    np.testing.assert_array_equal(one.instance_ids, other.instance_ids)
    assert one.labels == other.labels


LABELS = {"id_to_label": {"1": "cup_01", "2": "desk_lamp_3"}}


def write_video(
    path: Path,
    num: int = 20,
    codec: str = "libx264",
    times: Sequence[int] | None = None,
    *,
    make: Callable[[int], np.ndarray] = picture,
    pixels: str = "yuv420p",
    **options: str,
) -> None:
    with av.open(str(path), "w", options=options) as container:
        stream: Any = container.add_stream(codec, rate=10)
        stream.height, stream.width = make(0).shape[:2]
        stream.pix_fmt, stream.gop_size = pixels, 5
        for index in range(num):
            frame = av.VideoFrame.from_ndarray(make(index), format="rgb24")
            if times is not None:
                frame.pts, frame.time_base = times[index], Fraction(1, 10)
            container.mux(stream.encode(frame))
        container.mux(stream.encode())


def jpg(index: int) -> bytes:
    return encode_image(".jpg", picture(index))
