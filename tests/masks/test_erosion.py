import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from scipy import ndimage

from remind_jax.masks.erosion import erode_masks


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
