"""Several reductions in one pass give what each gives alone."""

import jax
import jax.numpy as jnp
import numpy as np

from remind_jax.numerics.reductions import pick_in_rows, reduce_together

VALUES = np.random.default_rng(0).integers(-3, 4, (4, 5, 6)).astype(np.float32)


def test_each_term_is_reduced_in_its_own_way():
    wholes, flags = VALUES.astype(np.int32), VALUES > 1
    total, count, most, least, some, every, (top, place) = reduce_together(
        ("sum", VALUES), ("sum", flags), ("max", wholes), ("min", VALUES), ("any", flags),
        ("all", flags), ("top", VALUES), axis=1,
    )  # fmt: skip
    np.testing.assert_array_equal(total, VALUES.sum(axis=1))
    np.testing.assert_array_equal(count, flags.sum(axis=1))
    np.testing.assert_array_equal(most, wholes.max(axis=1))
    np.testing.assert_array_equal(least, VALUES.min(axis=1))
    np.testing.assert_array_equal(some, flags.any(axis=1))
    np.testing.assert_array_equal(every, flags.all(axis=1))
    np.testing.assert_array_equal(top, VALUES.max(axis=1))
    np.testing.assert_array_equal(place, VALUES.argmax(axis=1))  # the first among equals


def test_terms_are_broadcast_and_axes_count_from_the_end():
    row, flags = VALUES[0, :1], VALUES[0] > 0
    total, count = reduce_together(("sum", row), ("sum", flags), axis=-1)
    np.testing.assert_array_equal(total, np.repeat(row.sum(), 5))
    np.testing.assert_array_equal(count, flags.sum(axis=1))


def test_where_nothing_is_larger_the_top_is_the_first():
    nothing = jnp.full((2, 3), -jnp.inf)
    ((value, place), some) = reduce_together(("top", nothing), ("any", nothing > 0), axis=1)
    np.testing.assert_array_equal(value, -jnp.inf)
    np.testing.assert_array_equal(place, 0)
    assert not some.any()


def test_it_is_one_reduction_also_in_a_batch():
    def find(values):
        return reduce_together(("top", values), ("sum", values), axis=0)

    (top, place), total = jax.vmap(find)(VALUES)
    np.testing.assert_array_equal(top, VALUES.max(axis=1))
    np.testing.assert_array_equal(place, VALUES.argmax(axis=1))
    np.testing.assert_array_equal(total, VALUES.sum(axis=1))
    assert str(jax.make_jaxpr(jax.vmap(find))(VALUES)).count("reduce[") == 1


def test_entries_of_rows_are_picked_and_are_nothing_outside():
    table, flags = VALUES[0], VALUES[0] > 0
    picked, is_set = pick_in_rows(jnp.array([0, 5, -1, 2, 6]), table, flags)
    np.testing.assert_array_equal(picked, [table[0, 0], table[1, 5], 0, table[3, 2], 0])
    np.testing.assert_array_equal(is_set, [flags[0, 0], flags[1, 5], False, flags[3, 2], False])
