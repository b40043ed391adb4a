import jax.numpy as jnp
import numpy as np

from remind_jax.numerics.row_lookup import look_up_in_rows


def test_entries_are_those_of_their_own_row():
    table = np.random.default_rng(0).normal(size=(3, 4)).astype(np.float32)
    index = np.array([[0, 3], [2, 2], [1, 0]])
    found = look_up_in_rows(jnp.array(table), jnp.array(index))
    np.testing.assert_array_equal(found, np.take_along_axis(table, index, axis=1))
