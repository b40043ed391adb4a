"""Masks as boxes: all that is made of them equals what is made of planes."""

import cv2
import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from scipy import ndimage

from remind_jax.crops import Crops
from remind_jax.masks.run_length import decode_mask, encode_masks


def blobs(seed: int, num: int = 7, size: tuple[int, int] = (90, 130)) -> np.ndarray:
    """Masks of several pieces, touching, overlapping, at the border; one is empty."""
    rng = np.random.default_rng(seed)
    masks = np.zeros((num, *size), bool)
    for mask in masks[1:]:
        for _ in range(rng.integers(1, 4)):
            top, left = rng.integers(0, size[0]), rng.integers(0, size[1])
            height, width = rng.integers(1, 40, 2)
            mask[top : top + height, left : left + width] |= rng.random(
                mask[top : top + height, left : left + width].shape
            ) < rng.choice([0.3, 1.0])
    return masks


@given(st.integers(0, 10_000))
@settings(max_examples=20, deadline=None)
def test_planes_come_back(seed):
    masks = blobs(seed)
    crops = Crops.of(masks)
    assert crops.shape == masks.shape
    assert np.array_equal(np.asarray(crops), masks)
    assert np.array_equal(np.asarray(crops[np.array([3, 1])]), masks[[3, 1]])
    assert np.array_equal(crops.areas, masks.sum(axis=(1, 2)))
    codes = encode_masks(masks)
    for row, mask in enumerate(masks):
        box = cv2.boundingRect(mask.view(np.uint8))
        assert tuple(crops.box(row)) == (box if mask.any() else (0, 0, 0, 0))
        assert np.array_equal(decode_mask(codes[row]), mask)
        for rows, columns in ((slice(0, 90), slice(0, 130)), (slice(20, 41), slice(60, 61))):
            assert np.array_equal(crops.region(row, rows, columns), mask[rows, columns])


@given(
    masks=hnp.arrays(bool, st.tuples(st.integers(0, 3), st.integers(1, 14), st.integers(1, 14))),
    radius=st.integers(0, 4),
)
def test_erosion_equals_scipy_with_a_foreground_outside(masks, radius):
    window = np.ones((2 * radius + 1,) * 2, bool)
    expected = [ndimage.binary_erosion(mask, window, border_value=1) for mask in masks]
    eroded = Crops.of(masks).eroded(radius, margin_px=radius)
    np.testing.assert_array_equal(eroded, np.reshape(expected, masks.shape))
