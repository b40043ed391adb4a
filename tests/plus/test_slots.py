"""Which row has which slot."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np

from remind_jax.numerics.absent import NO_SLOT
from remind_jax.plus.slots import NO_ROW, count_before, look_up, rows_of


def test_slots_find_their_rows():
    slot = jnp.array([3, NO_SLOT, 0, 1])
    has = jnp.array([True, True, True, False])
    assert rows_of(slot, has, 5).tolist() == [2, NO_ROW, NO_ROW, 0, NO_ROW]


def test_flags_are_counted_in_the_rows_before():
    flags = np.random.default_rng(0).random(40) < 0.5
    assert count_before(jnp.asarray(flags)).tolist() == (np.cumsum(flags) - flags).tolist()


def test_pairs_are_looked_up_by_both_slots():
    table = jnp.arange(18.0).reshape(3, 3, 2)
    found = look_up(table, jnp.array([[0], [2]]), jnp.array([[1, 2]]))
    assert found.tolist() == [[[2, 3], [4, 5]], [[14, 15], [16, 17]]]
