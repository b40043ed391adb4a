import jax
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from remind_jax.numerics.set_order import iteration_rank

RANK = jax.jit(iteration_rank, static_argnames="copied")


def iterate(ids, most, *, copied=True):
    """The first ids in the order of our ranks, of `most` slots."""
    padded = np.zeros(most, np.int32)
    padded[: len(ids)] = ids
    rank = np.asarray(RANK(padded, np.int32(len(ids)), copied=copied))
    assert sorted(rank) == list(range(most))
    return padded[np.argsort(rank)][: len(ids)].tolist()


def python_order(ids):
    grown = set()
    for number in ids:
        grown.add(number)
    return list(grown), list(set(grown))


@pytest.mark.parametrize("most", [1, 2, 4, 5, 7, 18, 19, 40, 90])
@given(data=st.data())
def test_order_is_that_of_a_python_set(most, data):
    largest = data.draw(st.sampled_from([most, 3 * most, 2000]))
    ids = data.draw(st.lists(st.integers(0, largest), max_size=most, unique=True))
    grown, copied = python_order(ids)
    assert iterate(ids, most) == copied
    assert iterate(ids, most, copied=False) == grown
