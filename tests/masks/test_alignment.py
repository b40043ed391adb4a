import cv2
import numpy as np
import pytest

from remind_jax.errors import UnreadableFrame
from remind_jax.masks.alignment import Alignment

# Frame, size after the width limit, left and top of the crop, patch grid (method.md#frame-size).
EXAMPLES = [
    ((968, 1296), (956, 1280), (0, 6), (59, 80)),
    ((1168, 1752), (853, 1280), (0, 2), (53, 80)),
    ((1080, 1920), (720, 1280), (0, 0), (45, 80)),
    ((479, 853), (479, 853), (2, 7), (29, 53)),
    ((480, 640), (480, 640), (0, 0), (30, 40)),
]


def fit(frame_size, patch_px, max_width_px=1280, center_crop=True):
    return Alignment.fit(frame_size, patch_px, max_width_px=max_width_px, center_crop=center_crop)


@pytest.mark.parametrize(("frame", "scaled", "corner", "grid"), EXAMPLES)
def test_examples_of_the_page(frame, scaled, corner, grid):
    alignment = fit(frame, 16)
    assert alignment.scaled_size == scaled
    assert (alignment.left, alignment.top) == corner
    assert alignment.size == (16 * grid[0], 16 * grid[1])
    at_corner = fit(frame, 16, center_crop=False)
    assert (at_corner.left, at_corner.top) == (0, 0)


def test_too_small_a_frame_is_refused():
    with pytest.raises(UnreadableFrame, match=r"smaller than one patch.*14"):
        fit((13, 500), 14)


def test_image_is_scaled_by_area_and_cropped():
    image = np.random.default_rng(0).integers(0, 256, (50, 200, 3), dtype=np.uint8)
    aligned = fit((50, 200), 8, max_width_px=100).align_image(image)
    scaled = cv2.resize(image, (100, 25), interpolation=cv2.INTER_AREA)
    np.testing.assert_array_equal(aligned, scaled[0:24, 2:98])


def test_masks_are_scaled_by_nearest_neighbor_like_one_label_map():
    labels = np.random.default_rng(1).integers(0, 4, (75, 303)).astype(np.uint8)
    masks = np.stack([labels == label for label in range(4)])
    alignment = fit((75, 303), 8, max_width_px=101)
    aligned = np.asarray(alignment.align_masks(masks))
    scaled = cv2.resize(labels, (101, 25), interpolation=cv2.INTER_NEAREST)
    np.testing.assert_array_equal(aligned.argmax(axis=0), scaled[0:24, 2:98])
    assert aligned.dtype == bool
    assert (aligned.sum(axis=0) == 1).all()


@pytest.mark.parametrize("width", [64, 40])
def test_no_masks(width):
    alignment = fit((40, 64), 8, max_width_px=width)
    aligned = alignment.align_masks(np.zeros((0, 40, 64), bool))
    assert aligned.shape == (0, *alignment.size)
    assert aligned.dtype == bool
