"""Colors of identities, and text that fits."""

import itertools

import cv2
import numpy as np
import pytest

from remind_jax.outputs import drawing
from remind_jax.outputs.drawing import identity_color, ink_on


def test_neighbors_differ_clearly():
    colors = [np.array(identity_color(object_id)) for object_id in range(12)]
    for a, b in itertools.combinations(colors, 2):
        assert np.abs(a - b).max() >= 35


def test_ink_has_contrast():
    assert ink_on((255, 255, 255)) != (255, 255, 255)
    assert ink_on((10, 10, 60)) == (255, 255, 255)


@pytest.fixture(params=["outline", "stroke"])
def font(request, monkeypatch):
    """Runs a test with the font of OpenCV 5 (where it is there) and with that of OpenCV 4."""
    if request.param == "outline" and not hasattr(cv2, "FontFace"):
        pytest.skip("OpenCV 4 has no outline font")
    if request.param == "stroke":
        monkeypatch.setattr(drawing, "_font", lambda: None)


@pytest.mark.usefixtures("font")
@pytest.mark.parametrize("size_px", [11, 14, 24])
def test_text_stays_within_its_measured_width(size_px):
    text = "Türgriff 12 or 7?"
    image = np.zeros((60, 600, 3), np.uint8)
    drawing.put_text(image, text, 20, 40, size_px, (255, 255, 255))
    columns = np.flatnonzero(image.any((0, 2)))
    width = drawing.text_width(text, size_px)
    # One pixel of antialiasing on either side.
    assert columns.min() >= 19
    assert columns.max() <= 20 + width + 1
    assert columns.max() >= 20 + 0.9 * width
