import dataclasses

import chex
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from remind_jax.remind.memory.bank import (
    Arrival,
    Room,
    make_room,
    merge_entries,
    place,
    weakest,
)
from remind_jax.remind.memory.prototypes import (
    DualBank,
    closest_pair,
    new_entry,
)
from tests.remind.memory.small_banks import NO, NOW, YES, bank_of, unit, vectors_of

# method.md#bank-room.
CROWDED = ([1, 0, 0], [0.9, 0.43589, 0], [0, 0, 1])


@pytest.mark.parametrize(("redundant", "index"), [(True, 1), (False, 2)])
def test_eviction_example_of_the_page(redundant, index):
    bank = bank_of(*CROWDED, last_seen=(5, 3, 1))
    cosine, i, j, everything = closest_pair(bank)
    assert (int(i), int(j)) == (0, 1)
    np.testing.assert_allclose(cosine, 0.9, atol=1e-6)
    assert int(weakest(bank, everything, jnp.bool_(redundant))) == index


def test_the_only_prototype_is_the_weakest():
    bank = bank_of(unit(0), slots=1)
    for redundant in (YES, NO):
        assert int(weakest(bank, closest_pair(bank)[3], redundant)) == 0


def test_opposite_prototypes_are_not_redundant():
    """A largest cosine of -1 counts as 0, so the least recently seen of all is given up."""
    bank = bank_of(unit(0), unit(180), last_seen=(4, 2), slots=2)
    assert int(weakest(bank, closest_pair(bank)[3], YES)) == 1


@pytest.mark.parametrize(("cap", "angle"), [(None, 45.0), (10, np.degrees(np.arctan(0.2)))])
def test_merging_adds_records(cap, angle):
    left, right = (
        dataclasses.replace(
            new_entry(unit(d), jnp.float32(q), jnp.int32(seen)), hits=jnp.int32(hits)
        )
        for d, q, seen, hits in ((0, 0.2, 3, 12), (90, 0.6, 5, 2))
    )
    joined = merge_entries(left, right, jnp.int32(4), None if cap is None else jnp.int32(cap))
    np.testing.assert_allclose(joined.embedding, unit(angle), atol=1e-6)
    assert (int(joined.hits), int(joined.last_seen), int(joined.num_qualities)) == (14, 5, 2)
    np.testing.assert_allclose(joined.quality_recent, 0.4, rtol=1e-6)


def test_room_is_made_at_the_lower_index():
    bank = bank_of(unit(90), unit(0), unit(8), slots=3)
    made = make_room(bank, YES, jnp.float32(0.9), YES, None, NOW)
    np.testing.assert_allclose(vectors_of(made), [unit(90), unit(4)], atol=1e-6)
    assert made.last_seen[:2].tolist() == [0, 9]
    kept = make_room(bank, NO, jnp.float32(0.9), YES, None, NOW)
    chex.assert_trees_all_equal(kept, bank)


def test_only_full_banks_that_take_something_make_room():
    """One channel, four objects: full work, full stable, not full, nothing arrives."""
    full, half = bank_of(unit(0), unit(50), slots=2), bank_of(unit(0), slots=2)
    stack = lambda *banks: jax.tree.map(lambda *leaves: jnp.stack(leaves)[None], *banks)  # noqa: E731
    banks = DualBank(stack(full, full, half, full), stack(full, full, full, full))
    value = new_entry(unit(90), jnp.float32(1), NOW)
    arrival = Arrival(
        value=stack(*[value] * 4),
        to_work=jnp.array([[True, False, True, False]]),
        to_stable=jnp.array([[False, True, False, False]]),
    )
    room = Room(
        capacity=jnp.array([[2, 2]]),
        merge=jnp.array([2.0, 2.0]),
        redundant=jnp.array([False, False]),
        cap=None,
    )
    placed = place(banks, arrival, room, NOW)
    expected = {  # degrees of the prototypes: work, stable
        0: ((50, 90), (0, 50)),
        1: ((0, 50), (50, 90)),
        2: ((0, 90), (0, 50)),
        3: ((0, 50), (0, 50)),
    }
    for n, sides in expected.items():
        for bank, degrees in zip((placed.work, placed.stable), sides, strict=True):
            found = jax.tree.map(lambda leaf: leaf[0, n], bank)  # noqa: B023
            np.testing.assert_allclose(vectors_of(found), [unit(d) for d in degrees], atol=1e-6)
