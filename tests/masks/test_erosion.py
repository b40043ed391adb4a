import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from scipy import ndimage

from remind_jax.masks.erosion import erode_masks


def square(size: int, top: int, left: int, shape: tuple[int, int] = (20, 30)) -> np.ndarray:
    mask = np.zeros(shape, bool)
    mask[top : top + size, left : left + size] = True
    return mask


def test_the_image_border_does_not_erode_with_a_margin():
    whole = np.ones((1, 9, 9), bool)
    assert np.all(np.asarray(erode_masks(whole, 2, margin_px=2)))
    (corner,) = erode_masks(square(7, 0, 0)[None], 2, margin_px=2)
    np.testing.assert_array_equal(corner, square(5, 0, 0))


@settings(deadline=None)
@given(
    masks=hnp.arrays(bool, st.tuples(st.integers(0, 3), st.integers(1, 14), st.integers(1, 14))),
    radius=st.integers(0, 4),
)
def test_erosion_equals_scipy_with_a_foreground_outside(masks, radius):
    window = np.ones((2 * radius + 1,) * 2, bool)
    expected = [ndimage.binary_erosion(mask, window, border_value=1) for mask in masks]
    eroded = erode_masks(masks, radius, margin_px=radius)
    np.testing.assert_array_equal(eroded, np.reshape(expected, masks.shape))
