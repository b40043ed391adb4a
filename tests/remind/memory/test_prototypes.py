import dataclasses

import chex
import jax.numpy as jnp
import numpy as np

from remind_jax.remind.memory.prototypes import (
    empty_bank,
    keep_rows,
    new_entry,
)
from tests.remind.memory.small_banks import (
    NOW,
    append,
    bank_of,
    edited,
    unit,
    vectors_of,
)


def test_removal_keeps_the_order():
    bank = bank_of(unit(0), unit(10), unit(20))
    left = edited(bank, gone=1)
    np.testing.assert_array_equal(vectors_of(left), [unit(0), unit(20)])
    assert left.last_seen[:2].tolist() == [0, 2]
    chex.assert_trees_all_equal(edited(bank), bank)


def test_writing_and_adding_only_when_told():
    bank = bank_of(unit(0), unit(10))
    value = new_entry(unit(90), jnp.float32(1), NOW)
    np.testing.assert_array_equal(vectors_of(edited(bank, at=0, value=value)), [unit(90), unit(10)])
    chex.assert_trees_all_equal(append(bank, value, when=False), bank)
    added = append(bank, value)
    np.testing.assert_array_equal(vectors_of(added), [unit(0), unit(10), unit(90)])
    assert added.last_seen.tolist()[2] == NOW


def test_a_prototype_that_takes_another_in_moves_up_when_an_earlier_one_goes():
    bank = bank_of(unit(0), unit(10), unit(20))
    value = new_entry(unit(15), jnp.float32(1), NOW)
    both = edited(bank, at=2, value=value, gone=0)
    np.testing.assert_array_equal(vectors_of(both), [unit(10), unit(15)])
    last = edited(bank, at=1, value=value, gone=2)
    np.testing.assert_array_equal(vectors_of(last), [unit(0), unit(15)])


def test_only_the_kept_rows_keep_their_banks():
    bank = empty_bank((2, 1, 3), 2, 2, jnp.dtype("float32"))
    full = dataclasses.replace(bank, size=jnp.array([[[2, 1, 2]]] * 2))
    kept = keep_rows(full, jnp.array([True, False, True]))
    assert kept.work.size.tolist() == kept.stable.size.tolist() == [[2, 0, 2]]
