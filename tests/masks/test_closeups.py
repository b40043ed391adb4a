"""Pictures of single detections: as large from afar as from near, and true to the mask."""

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from remind_jax.crops import Crops
from remind_jax.masks.closeups import CLOSEUP_PATCHES, MARGIN_PATCHES, OBJECT_PATCHES, cut_closeups

PATCH_PX = 16
SIDE = CLOSEUP_PATCHES * PATCH_PX


def picture(height: int = 240, width: int = 320, seed: int = 0) -> np.ndarray:
    """Smooth colors, so that scaling loses little."""
    coarse = np.random.default_rng(seed).integers(0, 256, (6, 8, 3), np.uint8)
    return cv2.resize(coarse, (width, height), interpolation=cv2.INTER_CUBIC)


def box(left: int, top: int, width: int, height: int, size=(240, 320)) -> np.ndarray:
    mask = np.zeros(size, bool)
    mask[top : top + height, left : left + width] = True
    return mask


@pytest.mark.parametrize("side", [12, 30, 48, 90, 160])
def test_a_mask_covers_as_many_patches_at_any_size(side):
    size = 600, 700
    mask = box(300, 250, side, side, size)
    found = cut_closeups(picture(*size), mask[None], PATCH_PX)
    assert found.images.shape == (1, SIDE, SIDE, 3)
    # A window is a whole number of pixels.
    assert np.sqrt(found.coverage.sum()) == pytest.approx(OBJECT_PATCHES, rel=0.02)


@pytest.mark.parametrize(("width", "height"), [(200, 10), (10, 200)])
def test_what_is_long_fits_into_the_picture(width, height):
    found = cut_closeups(picture(), box(40, 20, width, height)[None], PATCH_PX)
    covered = np.sqrt(found.coverage.sum() * width / height)  # patches along the width
    longest = max(covered, covered * height / width)
    assert longest == pytest.approx(CLOSEUP_PATCHES - MARGIN_PATCHES, rel=0.02)
    border = np.ones((CLOSEUP_PATCHES,) * 2, bool)
    border[1:-1, 1:-1] = False
    assert found.coverage[0][border].max() < 1


def test_the_picture_shows_what_the_frame_does_there():
    image = np.zeros((240, 320, 3), np.uint8)
    mask = box(100, 60, 48, 48)
    image[mask] = (200, 100, 50)
    found = cut_closeups(image, mask[None], PATCH_PX)
    inside = cv2.resize(found.coverage[0], (SIDE, SIDE), interpolation=cv2.INTER_NEAREST)
    assert (found.images[0][inside == 1] == (200, 100, 50)).all()
    assert not found.images[0][inside == 0].any()


def test_beyond_the_border_the_last_pixels_go_on():
    image = picture()
    found = cut_closeups(image, box(0, 100, 48, 48)[None], PATCH_PX)
    assert not found.coverage[0][:, 0].any()
    assert found.coverage[0][:, 2].any()
    first = found.images[0][:, : PATCH_PX // 2].astype(int)
    assert np.ptp(first, axis=1).max() <= 1


def test_an_empty_mask_has_a_black_picture_that_covers_nothing():
    found = cut_closeups(picture(), np.stack([box(0, 0, 0, 0), box(9, 9, 20, 20)]), PATCH_PX)
    assert len(found) == 2
    assert not found.images[0].any()
    assert not found.coverage[0].any()
    assert found.coverage[1].any()
    assert not len(cut_closeups(picture(), np.zeros((0, 240, 320), bool), PATCH_PX))


@settings(deadline=None, max_examples=30)
@given(
    boxes=st.lists(
        st.tuples(*[st.integers(0, high) for high in (319, 239, 320, 240)]), min_size=1, max_size=4
    ),
    patch_px=st.sampled_from([4, 8, 14, 16]),
)
def test_any_masks_give_sound_pictures_and_crops_give_the_same(boxes, patch_px):
    image, masks = picture(), np.stack([box(*one) for one in boxes])
    found = cut_closeups(image, masks, patch_px)
    of_crops = cut_closeups(image, Crops.of(masks), patch_px)
    for values, others in zip(vars(found).values(), vars(of_crops).values(), strict=True):
        np.testing.assert_array_equal(values, others)
    assert ((found.coverage >= 0) & (found.coverage <= 1 + 1e-5)).all()
    np.testing.assert_array_equal(found.coverage.any((1, 2)), masks.any((1, 2)))
