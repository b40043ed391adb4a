import jax
import jax.numpy as jnp
import numpy as np
import pytest

from remind_jax.remind.memory import bank_room, prototypes
from tests.remind.memory.small_banks import NO, YES, bank_of, unit

make_room, merge_entries = jax.jit(bank_room.make_room), jax.jit(bank_room.merge_entries)
weakest, closest_pair = jax.jit(bank_room.weakest), jax.jit(prototypes.closest_pair)
change, new_entry = jax.jit(prototypes.change), jax.jit(prototypes.new_entry)
# method.md#bank-room.
CROWDED = ([1, 0, 0], [0.9, 0.43589, 0], [0, 0, 1])


@pytest.mark.parametrize(("redundant", "index"), [(True, 1), (False, 2)])
def test_eviction_example_of_the_page(redundant, index):
    bank = bank_of(*CROWDED, last_seen=(5, 3, 1))
    cosine, i, j, everything = closest_pair(bank)
    assert (int(i), int(j)) == (0, 1)
    np.testing.assert_allclose(cosine, 0.9, atol=1e-6)
    assert int(weakest(bank, everything, cosine, jnp.bool_(redundant))) == index


def test_the_only_prototype_is_the_weakest():
    bank = bank_of(unit(0), slots=1)
    cosine, _, _, everything = closest_pair(bank)
    for redundant in (YES, NO):
        assert int(weakest(bank, everything, cosine, redundant)) == 0


def test_opposite_prototypes_are_not_redundant():
    """A largest cosine of -1 counts as 0, so the least recently seen of all is given up."""
    bank = bank_of(unit(0), unit(180), last_seen=(4, 2), slots=2)
    cosine, _, _, everything = closest_pair(bank)
    assert int(weakest(bank, everything, cosine, YES)) == 1
