import jax.numpy as jnp
import numpy as np
import pytest

from remind_jax.numerics.ranks import (
    count_before,
    first_largest,
    largest,
    order_rising,
    pick_best,
    rank_rising,
    rank_two,
)


def test_marked_entries_before_each():
    marked = jnp.array([[True, False, True, True], [False, False, False, True]])
    assert count_before(marked).tolist() == [[0, 1, 1, 2], [0, 0, 0, 0]]


def test_places_are_those_of_a_stable_sort_by_several_keys():
    rng = np.random.default_rng(3)
    first, second = rng.integers(0, 3, (2, 5, 12))
    place = np.broadcast_to(np.arange(12), first.shape)
    order = np.lexsort((place, second, first))
    keys = [jnp.array(first), jnp.array(-1.0 * -second)]
    np.testing.assert_array_equal(rank_rising(keys), np.argsort(order))
    np.testing.assert_array_equal(order_rising(keys), order)


def test_the_best_that_count_are_picked_and_padded():
    values = jnp.array([[0.5, 0.9, 0.5, 0.7], [0.1, 0.2, 0.3, 0.4]])
    among = jnp.array([[True, False, True, True], [False, False, False, False]])
    place, value = pick_best(values, among, 5)
    assert place.tolist() == [[3, 0, 2, -1, -1], [-1] * 5]
    np.testing.assert_allclose(value, [[0.7, 0.5, 0.5, 0, 0], [0] * 5])
    assert pick_best(values, among, 2, later_first=True)[0].tolist() == [[3, 2], [-1, -1]]
    best, top, second, number = rank_two(values, among)
    assert (best.tolist(), number.tolist()) == ([3, 0], [3, 0])
    np.testing.assert_allclose([top, second], [[0.7, 0], [0.5, 0]])


@pytest.mark.parametrize("axis", [0, 1, -1])
@pytest.mark.parametrize("dtype", [np.float32, np.int32, bool])
def test_the_largest_value_and_its_place_are_found_together(dtype, axis):
    rng = np.random.default_rng(3)
    values = rng.integers(0, 3, (7, 9)).astype(dtype)  # many are equal
    if dtype is np.float32:
        values[2], values[:, 4] = -np.inf, -np.inf
    value, place = largest(jnp.asarray(values), axis)
    np.testing.assert_array_equal(value, values.max(axis=axis))
    np.testing.assert_array_equal(place, values.argmax(axis=axis))


def test_the_largest_entry_of_a_table_by_several_keys():
    rng = np.random.default_rng(3)
    keys = rng.integers(0, 3, (2, 6, 5)).astype(np.float32)  # many are equal
    among = rng.random((6, 5)) < 0.5
    order = np.lexsort((np.arange(30), -keys[1].ravel(), -keys[0].ravel()))
    expected = next(at for at in order if among.flat[at])
    counted = [jnp.where(among, key, -np.inf) for key in keys]
    *values, row, column = first_largest(counted, jnp.asarray(among))
    assert 5 * int(row) + int(column) == expected
    assert [float(value) for value in values] == [float(key.flat[expected]) for key in keys]
    assert [int(place) for place in first_largest(counted)[-2:]] == [int(row), int(column)]


def test_no_entry_counts():
    nothing = jnp.full((3, 4), -jnp.inf)
    _, row, column = first_largest([nothing], jnp.zeros((3, 4), bool))
    assert row >= 3
    assert column >= 4
