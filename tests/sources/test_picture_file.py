"""What headers of pictures say, and what is refused for it before memory is taken."""

from __future__ import annotations

import struct
import zlib

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from remind_jax.sources.image_folder import decode_image, decode_pixels
from remind_jax.sources.picture_file import check_picture
from remind_jax.sources.source import UnreadableFrame
from tests.sources import making

KINDS = {
    "png": (".png", []),
    "jpeg": (".jpg", []),
    "progressive jpeg": (
        ".jpg",
        [cv2.IMWRITE_JPEG_PROGRESSIVE, 1, cv2.IMWRITE_JPEG_RST_INTERVAL, 2],
    ),
    "lossy webp": (".webp", [cv2.IMWRITE_WEBP_QUALITY, 50]),
    "lossless webp": (".webp", [cv2.IMWRITE_WEBP_QUALITY, 101]),
    "bmp": (".bmp", []),
    "tiff": (".tiff", []),
}


def encoded(kind: str, height: int = 7, width: int = 19) -> bytes:
    suffix, options = KINDS[kind]
    ok, data = cv2.imencode(suffix, making.picture(1, (height, width)), options)
    assert ok
    return data.tobytes()


@pytest.mark.parametrize("kind", KINDS)
def test_sizes_are_those_of_the_pixels(kind):
    assert check_picture(encoded(kind)) == decode_image(encoded(kind)).shape[:2] == (7, 19)


def test_a_jpeg_of_many_scans_is_refused():
    """Each of them would be decoded to the full size: hours, of a file of a megabyte."""
    whole = encoded("progressive jpeg")
    assert whole.count(b"\xff\xda") > 5
    last = whole.rindex(b"\xff\xda")
    many = whole[:last] + 95 * whole[last:-2] + whole[-2:]
    hidden = b"\xff\xfe\x00\x04\xff\xd9"  # a comment that looks like the end
    for data in (many, whole[:last] + hidden + 95 * whole[last:-2] + whole[-2:]):
        with pytest.raises(UnreadableFrame, match="scans, at most 100 are read"):
            check_picture(data)
    assert check_picture(whole + 200 * b"\xff\xda") == (7, 19)  # a film behind the picture


@pytest.mark.parametrize(
    ("kind", "said"),
    [
        ("float32", "its samples are floats of 32 bits"),
        ("float64", "its samples are floats of 64 bits"),
        ("int32", "its samples are numbers with a sign of 32 bits"),
        ("uint32", "its samples are whole numbers of 32 bits"),
        ("int16", "its samples are numbers with a sign of 16 bits"),
    ],
)
@pytest.mark.parametrize("channels", [1, 3])
def test_samples_that_are_no_brightness_are_refused(kind, said, channels):
    ok, data = cv2.imencode(".tiff", np.ones((7, 19, channels), kind))
    assert ok
    with pytest.raises(UnreadableFrame, match=f"{said}; give whole numbers of 8 or 16 bits"):
        decode_image(data.tobytes())
    assert decode_pixels(data.tobytes(), cv2.IMREAD_UNCHANGED).dtype == kind


def test_a_tiff_that_names_its_width_twice_is_as_wide_as_the_larger_one():
    data = bytearray(encoded("tiff"))
    (at,) = struct.unpack_from("<I", data, 4)
    tags = [struct.unpack_from("<H", data, at + 2 + 12 * i)[0] for i in range(8)]
    height = at + 2 + 12 * tags.index(257)
    data[height : height + 12] = struct.pack("<HHII", 256, 4, 1, 60_000)
    with pytest.raises(UnreadableFrame, match="it claims 60000x0 pixels"):
        check_picture(bytes(data))


def paged(num: int, kind: int | None = None) -> bytes:
    """A TIFF of so many pages; the later ones are of a kind, if that is said."""
    pages = [making.picture(number, (7, 19)) for number in range(num)]
    ok, data = cv2.imencodemulti(".tiff", pages)
    assert ok
    data = bytearray(data.tobytes())
    (at,) = struct.unpack_from("<I", data, 4)
    while at:
        (count,) = struct.unpack_from("<H", data, at)
        entries = range(at + 2, at + 2 + 12 * count, 12)
        (next_at,) = struct.unpack_from("<I", data, at + 2 + 12 * count)
        for entry in entries:
            (tag,) = struct.unpack_from("<H", data, entry)
            if tag == 254 and kind is not None and len(pages) < num:
                struct.pack_into("<I", data, entry + 8, kind)
        at = next_at
        pages = pages[1:]
    return bytes(data)


def test_several_pages_are_no_picture():
    for num in (2, 100):
        with pytest.raises(UnreadableFrame, match="several pages"):
            check_picture(paged(num))


@pytest.mark.parametrize("kind", [1, 4, 5])
def test_smaller_copies_and_masks_lie_beside_a_picture(kind):
    data = paged(3, kind)
    assert data != paged(3)
    assert check_picture(data) == decode_image(data).shape[:2] == (7, 19)


def test_pages_in_a_circle_are_read_to_an_end():
    data = bytearray(paged(1))
    (at,) = struct.unpack_from("<I", data, 4)
    (count,) = struct.unpack_from("<H", data, at)
    struct.pack_into("<I", data, at + 2 + 12 * count, at)
    with pytest.raises(UnreadableFrame, match="several pages"):
        check_picture(bytes(data))


@given(
    kind=st.sampled_from(list(KINDS)),
    keep=st.floats(0, 1),
    flips=st.lists(st.integers(0), max_size=3),
)
def test_whatever_is_damaged_is_decoded_or_refused(kind, keep, flips):
    data = bytearray(encoded(kind))
    data = data[: round(keep * len(data))]
    for flip in flips:
        if data:
            data[flip // 8 % len(data)] ^= 1 << flip % 8
    try:
        decode_image(bytes(data))
    except UnreadableFrame:
        return


@pytest.mark.parametrize("at", [30, 45])
def test_a_flipped_bit_of_a_png_is_found_by_its_checksum(at):
    data = bytearray(encoded("png"))
    data[at] ^= 4
    with pytest.raises(UnreadableFrame, match="damaged"):
        check_picture(bytes(data))


def claim(kind: str, height: int, width: int) -> bytes:
    """A small file of a kind that claims another size."""
    data = bytearray(encoded(kind))
    if kind == "png":
        data[16:24] = struct.pack(">II", width, height)
        data[29:33] = struct.pack(">I", zlib.crc32(data[12:29]))
    elif kind == "jpeg":
        at = data.find(b"\xff\xc0")
        data[at + 5 : at + 9] = struct.pack(">HH", height, width)
    elif kind == "bmp":
        data[18:26] = struct.pack("<ii", width, height)
    else:
        (at,) = struct.unpack_from("<I", data, 4)
        (count,) = struct.unpack_from("<H", data, at)
        for entry in range(at + 2, at + 2 + 12 * count, 12):
            (tag,) = struct.unpack_from("<H", data, entry)
            if tag in (256, 257):
                struct.pack_into("<HHII", data, entry, tag, 4, 1, width if tag == 256 else height)
    return bytes(data)


@pytest.mark.parametrize("kind", ["png", "jpeg", "bmp", "tiff"])
@pytest.mark.parametrize("size", [(60000, 60000), (0, 5), (5, 0)])
def test_impossible_sizes_are_refused(kind, size):
    with pytest.raises(UnreadableFrame, match=f"claims {size[1]}x{size[0]} pixels"):
        check_picture(claim(kind, *size))


def animated_png():
    """A picture that says it has two frames."""
    data, body = encoded("png"), b"acTL" + struct.pack(">II", 2, 0)
    chunk = struct.pack(">I", 8) + body + struct.pack(">I", zlib.crc32(body))
    return data[:33] + chunk + data[33:]


def animated_webp():
    """The head of an animation."""
    body = b"WEBPVP8X" + struct.pack("<I", 10) + bytes([2, 0, 0, 0, 9, 0, 0, 9, 0, 0])
    return b"RIFF" + struct.pack("<I", len(body)) + body


@pytest.mark.parametrize("make", [animated_png, animated_webp])
def test_an_animation_is_no_picture(make):
    with pytest.raises(UnreadableFrame, match="it is an animation, not one picture"):
        check_picture(make())


@pytest.mark.parametrize(
    "data", [b"", b"GIF89a", b"<svg/>", b"P6 60000 60000 255\n", b"\xff\xd8\xff", b"RIFF", b"BM"]
)
def test_what_is_no_picture_is_refused(data):
    with pytest.raises(UnreadableFrame):
        check_picture(data)
