import cv2
import numpy as np
import pytest

from remind_jax.errors import SourceError
from remind_ros.images import read_instance_map, read_picture
from tests.ros import messages

PICTURE = np.random.default_rng(0).integers(0, 255, (6, 8, 3), np.uint8)
GRAY = PICTURE[..., 0]


@pytest.mark.parametrize("padding", [0, 5])
@pytest.mark.parametrize(
    ("encoding", "pixels", "expected"),
    [
        ("rgb8", PICTURE, PICTURE),
        ("bgr8", PICTURE[..., ::-1], PICTURE),
        ("8UC3", PICTURE[..., ::-1], PICTURE),
        ("rgba8", np.dstack([PICTURE, GRAY]), PICTURE),
        ("bgra8", np.dstack([PICTURE[..., ::-1], GRAY]), PICTURE),
        ("mono8", GRAY, np.dstack([GRAY] * 3)),
    ],
)
def test_pictures_are_read_in_their_encoding(encoding, pixels, expected, padding):
    message = messages.image(np.ascontiguousarray(pixels), encoding, padding=padding)
    np.testing.assert_array_equal(read_picture(message), expected)


@pytest.mark.parametrize(
    ("encoding", "first"),
    [("bayer_rggb8", 0), ("bayer_bggr8", 2)],
)
def test_mosaics_start_with_the_color_of_their_name(encoding, first):
    mosaic = np.zeros((16, 16), np.uint8)
    mosaic[::2, ::2] = 200  # the first letter's pixels
    seen = read_picture(messages.image(mosaic, encoding))
    assert seen[4:12, 4:12, first].mean() > 90
    assert seen[4:12, 4:12, 2 - first].max() == 0


@pytest.mark.parametrize(("encoding", "luma"), [("uyvy", 1), ("yuv422", 1), ("yuyv", 0)])
def test_luma_and_chroma_are_told_apart(encoding, luma):
    pixels = np.full((4, 6, 2), 128, np.uint8)
    pixels[:, :, luma] = 235
    assert read_picture(messages.image(pixels, encoding)).min() > 250


def test_compressed_pictures_are_decoded():
    data = cv2.imencode(".png", PICTURE[..., ::-1])[1]
    message = messages.make(
        "sensor_msgs/msg/CompressedImage", header=messages.header(), format="png", data=data
    )
    np.testing.assert_array_equal(read_picture(message), PICTURE)


@pytest.mark.parametrize("size", [0, 40])
def test_damaged_compressed_pictures_are_refused(size):
    data = cv2.imencode(".png", PICTURE)[1].ravel()[:size]
    message = messages.make(
        "sensor_msgs/msg/CompressedImage", header=messages.header(), format="png", data=data
    )
    with pytest.raises(SourceError, match=f"{size} bytes .*send JPEG or PNG"):
        read_picture(message)


@pytest.mark.parametrize(
    ("encoding", "kind"),
    [("mono8", "u1"), ("mono16", "<u2"), ("16UC1", ">u2"), ("16SC1", "<i2"), ("32SC1", "<i4")],
)
def test_instance_maps_keep_their_numbers(encoding, kind):
    numbers = np.array([[0, 1, 2], [100, 3, 0]], kind)
    read = read_instance_map(messages.image(numbers, encoding, padding=3))
    np.testing.assert_array_equal(read, numbers.astype(int))


def test_what_cannot_be_read_is_refused_in_one_sentence():
    with pytest.raises(SourceError, match="encoding '32FC1'; send one of"):
        read_picture(messages.image(np.zeros((2, 2), np.float32), "32FC1"))
    with pytest.raises(SourceError, match="encoding 'rgb8'"):
        read_instance_map(messages.image(PICTURE))
    short = messages.image(PICTURE)
    short.data = short.data[:-1]
    with pytest.raises(SourceError, match="143 bytes in all; needed are 24 and 144"):
        read_picture(short)
    with pytest.raises(SourceError, match="'yuyv'"):
        read_picture(messages.image(np.zeros((4, 5, 2), np.uint8), "yuyv"))
    empty = messages.image(PICTURE)
    empty.width = 0
    with pytest.raises(SourceError, match="0x6 pixels"):
        read_picture(empty)
