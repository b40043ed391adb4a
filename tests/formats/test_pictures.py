"""Pictures are decoded, or refused before memory is taken; numbers of instance maps survive."""

import struct
import zlib

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from remind_jax.errors import UnreadableFrame
from remind_jax.formats.pictures import check_picture, decode_image, read_label_map
from tests.sources import making

KINDS = {
    "png": (".png", []),
    "jpeg": (".jpg", []),
    "progressive jpeg": (".jpg", [cv2.IMWRITE_JPEG_PROGRESSIVE, 1]),
    "lossy webp": (".webp", [cv2.IMWRITE_WEBP_QUALITY, 50]),
    "lossless webp": (".webp", [cv2.IMWRITE_WEBP_QUALITY, 101]),
    "bmp": (".bmp", []),
    "tiff": (".tiff", []),
}


def encoded(kind: str) -> bytes:
    suffix, options = KINDS[kind]
    return making.encode_image(suffix, making.picture(1, (7, 19)), options)


def refuse(data: bytes) -> None:
    with pytest.raises(UnreadableFrame):
        decode_image(data)


def test_sizes_are_those_of_the_pixels():
    for kind in KINDS:
        assert check_picture(encoded(kind)).size == (19, 7)
        assert decode_image(encoded(kind)).shape == (7, 19, 3)


def test_a_jpeg_of_many_scans_is_refused():
    """Each of them would be decoded to the full size: hours, of a file of a megabyte."""
    whole = encoded("progressive jpeg")
    last = whole.rindex(b"\xff\xda")
    refuse(whole[:last] + 95 * whole[last:-2] + whole[-2:])
    film = np.random.default_rng(0).integers(0, 256, 1 << 22, np.uint8).tobytes()
    assert check_picture(encoded("jpeg") + film).size == (19, 7)


def test_samples_that_are_no_brightness_are_refused():
    for kind in ("float32", "float64", "int32", "int16"):
        for channels in (1, 3):
            ok, data = cv2.imencode(".tiff", np.full((7, 19, channels), 0.5, kind))
            assert ok
            refuse(data.tobytes())


def test_several_pages_and_animations_are_no_picture():
    pages = [making.picture(number, (7, 19)) for number in range(3)]
    ok, tiff = cv2.imencodemulti(".tiff", pages)
    assert ok
    data, body = encoded("png"), b"acTL" + struct.pack(">II", 2, 0)
    chunk = struct.pack(">I", 8) + body + struct.pack(">I", zlib.crc32(body))
    ok, webp = cv2.imencodemulti(".webp", pages)
    for picture in (tiff.tobytes(), data[:33] + chunk + data[33:], *([webp.tobytes()] * ok)):
        refuse(picture)


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
    for read in (decode_image, read_label_map):
        try:
            read(bytes(data))
        except UnreadableFrame:
            continue


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


def test_impossible_sizes_are_refused():
    for kind in ("png", "jpeg", "bmp", "tiff"):
        for size in ((60000, 60000), (9000, 9000), (0, 5), (5, 0)):
            refuse(claim(kind, *size))


def test_what_is_no_picture_is_refused():
    no_pictures = (b"GIF89a", b"<svg/>", b"P6 60000 60000 255\n", b"\xff\xd8\xff", b"RIFF", b"BM")
    for data in (b"", *no_pictures):
        refuse(data)


@pytest.mark.parametrize("depth", [1, 2, 4, 8])
@pytest.mark.parametrize("color_type", [0, 3], ids=["gray", "palette"])
@settings(max_examples=20, deadline=None)
@given(data=st.data())
def test_numbers_survive_every_depth(depth, color_type, data):
    shape = data.draw(st.tuples(st.integers(1, 9), st.integers(1, 19)))
    pixels = data.draw(hnp.arrays(np.uint8, shape, elements=st.integers(0, 2**depth - 1)))
    num_colors = 2**depth if color_type == 3 else 0
    png = making.png(pixels, depth, color_type, num_colors)
    np.testing.assert_array_equal(read_label_map(png), pixels)


def test_sixteen_bits_and_gray_stored_as_color():
    labels = making.instance_map(ids=(7, 40_000))
    np.testing.assert_array_equal(read_label_map(making.gray_png(labels)), labels)
    labels = making.instance_map()
    gray = making.gray_png(np.repeat(labels[..., None], 3, axis=2))
    np.testing.assert_array_equal(read_label_map(gray), labels)


@pytest.mark.usefixtures("unchecked_shapes")
def test_what_is_no_instance_map_is_refused():
    colors = np.zeros((8, 8, 3), np.uint8)
    colors[2:4, 2:4] = (255, 0, 128)
    fractions = cv2.imencode(".tiff", np.full((4, 4), 0.5, np.float32))[1].tobytes()
    giant = bytearray(making.palette_png(making.instance_map()))
    giant[16:24] = (100_000).to_bytes(4, "big") * 2
    giant[29:33] = zlib.crc32(giant[12:29]).to_bytes(4, "big")
    files = [making.gray_png(colors), fractions, bytes(giant)]
    for make in (making.gray_png, making.palette_png):
        files += [make(making.instance_map())[:keep] for keep in (0, 10, 40)]
    for data in files:
        with pytest.raises(UnreadableFrame):
            read_label_map(data)
