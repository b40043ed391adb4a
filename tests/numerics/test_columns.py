"""Values stand side by side in their order."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np

from remind_jax.numerics.columns import columns


def test_values_stand_side_by_side():
    side_by_side = columns(jnp.array([[1, 2], [3, 4]]), jnp.array([5, 6]), 7)
    np.testing.assert_array_equal(side_by_side, [[[1, 5, 7], [2, 6, 7]], [[3, 5, 7], [4, 6, 7]]])
