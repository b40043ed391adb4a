import zlib

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from remind_jax.sources.annotation_png import read_label_map
from remind_jax.sources.source import UnreadableFrame
from tests.sources import making


@pytest.mark.parametrize("depth", [1, 2, 4, 8])
@pytest.mark.parametrize("color_type", [0, 3], ids=["gray", "palette"])
@settings(max_examples=20, deadline=None)
@given(data=st.data())
def test_numbers_survive_every_depth(depth, color_type, data):
    shape = data.draw(st.tuples(st.integers(1, 9), st.integers(1, 19)))
    pixels = data.draw(hnp.arrays(np.uint8, shape, elements=st.integers(0, 2**depth - 1)))
    num_colors = 2**depth if color_type == 3 else 0
    encoded = making.png(pixels, depth, color_type, num_colors)
    np.testing.assert_array_equal(read_label_map(encoded), pixels)


def test_sixteen_bits():
    labels = making.instance_map(ids=(7, 40_000))
    np.testing.assert_array_equal(read_label_map(making.gray_png(labels)), labels)


def test_gray_stored_as_color():
    labels = making.instance_map()
    encoded = making.gray_png(np.repeat(labels[..., None], 3, axis=2))
    np.testing.assert_array_equal(read_label_map(encoded), labels)


def test_color_picture_is_refused():
    colors = np.zeros((8, 8, 3), np.uint8)
    colors[2:4, 2:4] = (255, 0, 128)
    with pytest.raises(UnreadableFrame, match="color picture"):
        read_label_map(making.gray_png(colors))


@pytest.mark.parametrize("make", [making.gray_png, making.palette_png])
@pytest.mark.parametrize("keep_bytes", [0, 10, 40])
def test_damaged_files_are_refused(make, keep_bytes):
    with pytest.raises(UnreadableFrame):
        read_label_map(make(making.instance_map())[:keep_bytes])


def test_giant_picture_is_refused_before_memory_is_taken():
    header = bytearray(making.palette_png(making.instance_map()))
    header[16:24] = (100_000).to_bytes(4, "big") * 2
    header[29:33] = zlib.crc32(header[12:29]).to_bytes(4, "big")
    with pytest.raises(UnreadableFrame, match="100000x100000"):
        read_label_map(bytes(header))


@pytest.mark.usefixtures("unchecked_shapes")
def test_fractions_are_refused():
    ok, data = cv2.imencode(".tiff", np.full((4, 4), 0.5, np.float32))
    assert ok
    with pytest.raises(UnreadableFrame, match="float32"):
        read_label_map(data.tobytes())
