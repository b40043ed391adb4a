import jax
import jax.numpy as jnp
import numpy as np
import pytest

from remind_jax.remind.memory import bank_room, prototypes
from tests.remind.memory.small_banks import bank_of

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
