import jax.numpy as jnp
import numpy as np

from remind_jax.numerics.ranks import count_before, rank_rising


def test_marked_entries_before_each():
    marked = jnp.array([[True, False, True, True], [False, False, False, True]])
    assert count_before(marked).tolist() == [[0, 1, 1, 2], [0, 0, 0, 0]]


def test_places_are_those_of_a_stable_sort_by_several_keys():
    rng = np.random.default_rng(3)
    first, second = rng.integers(0, 3, (2, 5, 12))
    place = np.broadcast_to(np.arange(12), first.shape)
    expected = np.argsort(np.lexsort((place, second, first)))
    found = rank_rising([jnp.array(first), jnp.array(-1.0 * -second)])
    np.testing.assert_array_equal(found, expected)
