"""Slices in a batch are those of its members, and stay slices where a batch shares a place."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from remind_jax.numerics.slices import put_slice, take_slice

ARRAYS = np.arange(2 * 3 * 5 * 4, dtype=np.float32).reshape(2, 3, 5, 4)
ROWS = -np.arange(2 * 3 * 2 * 4, dtype=np.float32).reshape(2, 3, 2, 4)


def _primitives(function, *arguments):
    text = str(jax.make_jaxpr(function)(*arguments))
    return {name for name in ("gather", "scatter", "dynamic_slice") if f"{name}[" in text}


@pytest.mark.parametrize("start", [0, 2, 3, 9])  # what lies too far is moved back into the array
def test_slices_of_one_array(start):
    array, rows = ARRAYS[0, 0], ROWS[0, 0]
    at = min(start, 3)
    np.testing.assert_array_equal(take_slice(array, jnp.int32(start), 2), array[at : at + 2])
    expected = array.copy()
    expected[at : at + 2] = rows
    np.testing.assert_array_equal(put_slice(array, rows, jnp.int32(start)), expected)


@pytest.mark.parametrize("axis", [0, 1])
def test_slices_along_an_axis(axis):
    taken = take_slice(ARRAYS[0, 0], jnp.int32(1), 2, axis)
    np.testing.assert_array_equal(taken, np.take(ARRAYS[0, 0], [1, 2], axis))


def test_nested_batches_with_one_place_keep_slices():
    def both(array, rows, start):
        return take_slice(array, start, 2), put_slice(array, rows, start)

    nested = jax.vmap(jax.vmap(both, (0, 0, None)), (0, 0, None))
    taken, put = nested(ARRAYS, ROWS, jnp.int32(3))
    np.testing.assert_array_equal(taken, ARRAYS[:, :, 3:])
    np.testing.assert_array_equal(put[:, :, 3:], ROWS)
    np.testing.assert_array_equal(put[:, :, :3], ARRAYS[:, :, :3])
    assert _primitives(nested, ARRAYS, ROWS, jnp.int32(3)) == {"dynamic_slice"}


def test_every_member_may_have_a_place_of_its_own():
    starts = np.array([0, 3], np.int32)
    taken = jax.vmap(lambda array, start: take_slice(array, start, 2, 1))(ARRAYS, starts)
    np.testing.assert_array_equal(taken, np.stack([ARRAYS[0, :, :2], ARRAYS[1, :, 3:]]))
