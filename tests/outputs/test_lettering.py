import cv2
import numpy as np
import pytest

from remind_jax.outputs import lettering


@pytest.fixture(params=["outline", "stroke"])
def font(request, monkeypatch):
    """Runs a test with the font of OpenCV 5 (where it is there) and with that of OpenCV 4."""
    if request.param == "outline" and not hasattr(cv2, "FontFace"):
        pytest.skip("OpenCV 4 has no outline font")
    if request.param == "stroke":
        monkeypatch.setattr(lettering, "_font", lambda: None)


@pytest.mark.usefixtures("font")
@pytest.mark.parametrize("size_px", [11, 14, 24])
def test_text_stays_within_its_measured_width(size_px):
    text = "Türgriff 12 or 7?"
    image = np.zeros((60, 600, 3), np.uint8)
    lettering.put_text(image, text, 20, 40, size_px, (255, 255, 255))
    columns = np.flatnonzero(image.any((0, 2)))
    width = lettering.text_width(text, size_px)
    # One pixel of antialiasing on either side.
    assert columns.min() >= 19
    assert columns.max() <= 20 + width + 1
    assert columns.max() >= 20 + 0.9 * width


@pytest.mark.usefixtures("font")
def test_shortened_text_fits_and_keeps_its_tail():
    text = "a very long class name"
    short = lettering.shorten(text, 14, 110, tail=" 31")
    assert short.startswith("a very")
    assert short.endswith("... 31")
    assert lettering.text_width(short, 14) <= 110
    assert lettering.shorten("cup", 14, 110, tail=" 3") == "cup 3"
