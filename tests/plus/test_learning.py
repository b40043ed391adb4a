"""What decided detections teach: kept looks, births, absorbed objects, relations."""

from __future__ import annotations

import dataclasses

import jax.numpy as jnp
import numpy as np
import pytest

from remind_jax.numerics.absent import NO_SLOT
from remind_jax.plus.learning import (
    absorb,
    create_objects,
    forget_pairs,
    keep_looks,
    learn_relations,
)
from remind_jax.plus.state import UNRELATED
from tests.plus.frames import STATIC, T, detections, empty_state, objects_of, tracklets_of

X, Y = np.eye(3, dtype=np.float32)[:2]
SURE = jnp.array([True, True, False])
SLOTS = jnp.array([0, 1, 0])


def keep(objects, slot, look):
    """One look kept of one object; the other detections keep nothing."""
    slots = jnp.array([slot, 0, 0])
    looks = jnp.zeros((3, 3)).at[0].set(look)
    keeps = jnp.array([True, False, False])
    return keep_looks(objects, empty_state().scene, slots, looks, keeps, T.memory)


def test_a_close_look_joins_the_nearest_kept_one():
    after = keep(objects_of([X]), 0, 1.2 * X)
    assert after.bank_count[0].tolist()[:2] == [2, 0]
    np.testing.assert_allclose(after.bank[0, 0], 1.1 * X, rtol=1e-6)
    np.testing.assert_allclose(after.white_bank[0, 0], X, rtol=1e-5)


def test_a_new_look_is_added_where_there_is_room():
    after = keep(objects_of([X]), 0, Y)
    assert after.bank_count[0].tolist()[:3] == [1, 1, 0]
    np.testing.assert_allclose(after.bank[0, 1], Y)


def test_a_full_bank_averages_even_what_is_new():
    objects = objects_of([X])
    full = dataclasses.replace(
        objects,
        bank=jnp.broadcast_to(jnp.asarray(X), objects.bank.shape),
        white_bank=jnp.broadcast_to(jnp.asarray(X), objects.white_bank.shape),
        bank_count=jnp.full_like(objects.bank_count, 20),
    )
    after = keep(full, 0, Y)
    assert after.bank_count[0].sum() == full.bank_count[0].sum() + 1
    np.testing.assert_allclose(
        after.bank[0, 0], X + (Y - X) / T.memory.rate_samples, rtol=1e-5, atol=1e-6
    )


def test_new_objects_take_the_lowest_free_slots():
    objects = objects_of([X, Y])
    gap = dataclasses.replace(objects, id=jnp.array([4, -1, 5, -1]))
    begun = tracklets_of(
        detections([[1, 1], [2, 2], [3, 3]]), 6, 3, slot=jnp.array([NO_SLOT, 2, NO_SLOT])
    )
    born = jnp.array([True, False, True])
    after, pairs, slot = create_objects(gap, empty_state().pairs, begun, born, jnp.full(3, 0.2))
    assert slot.tolist() == [1, 2, 3]
    assert after.id.tolist() == [4, 0, 5, 2]  # called as their tracklets
    assert after.last[1] == 6
    np.testing.assert_allclose(after.position[3], [3, 3])
    np.testing.assert_allclose(jnp.diag(pairs.covariance), [0, 0.2, 0, 0.2])


def related_pairs():
    """Every two objects were seen together and lie in a row."""
    state = empty_state()
    objects = objects_of([X, Y, X + Y])
    seen = detections([[1, 1], [2, 1], [4, 1]])
    everyone = jnp.ones(3, bool)
    return objects, learn_relations(
        objects, state.pairs, jnp.array([0, 1, 2]), everyone, seen, T.layout
    )


def test_relations_are_in_sizes_and_opposite():
    _, pairs = related_pairs()
    np.testing.assert_allclose(pairs.relation[0, 2], [3, 0], atol=1e-6)
    np.testing.assert_allclose(pairs.relation, -jnp.swapaxes(pairs.relation, 0, 1), atol=1e-6)
    assert pairs.covisible[0, 1] == 1
    assert pairs.spread[0, 1] < UNRELATED
    assert pairs.spread[0, 3] == UNRELATED  # a free slot


def test_relations_that_are_known_better_are_not_overwritten():
    objects, pairs = related_pairs()
    lost = dataclasses.replace(pairs, covariance=jnp.asarray(pairs.covariance).at[2, 2].set(1.0))
    seen = detections([[1, 1], [2, 1], [9, 9]])
    after = learn_relations(objects, lost, jnp.array([0, 1, 2]), SURE, seen, T.layout)
    np.testing.assert_allclose(after.relation[0, 2], pairs.relation[0, 2])
    assert after.covisible[0, 2] == pairs.covisible[0, 2]
    assert after.covisible[0, 1] == pairs.covisible[0, 1] + 1


def test_an_absorbed_object_hands_over_its_counts_and_frees_its_slot():
    objects, pairs = related_pairs()
    absorbed = jnp.array([True, False, False])
    after, left = absorb(
        objects, pairs, jnp.array([2, 1, 0]), jnp.array([0, NO_SLOT, NO_SLOT]), absorbed
    )
    assert after.id.tolist() == [0, 1, -1, -1]
    assert after.seen[0] == objects.seen[0] + objects.seen[2]
    assert left.covisible[0, 1] == pairs.covisible[0, 1] + pairs.covisible[2, 1]
    assert left.covisible[0, 1] == left.covisible[1, 0]
    assert (left.spread[2] == UNRELATED).all()


@pytest.mark.parametrize("slot", range(STATIC.num_objects))
def test_what_is_forgotten_is_forgotten_from_both_sides(slot):
    _, pairs = related_pairs()
    after = forget_pairs(pairs, jnp.arange(STATIC.num_objects) == slot)
    assert (after.spread[slot] == UNRELATED).all()
    assert (after.spread[:, slot] == UNRELATED).all()
    assert (after.covisible[slot] == 0).all()
    others = np.arange(STATIC.num_objects) != slot
    np.testing.assert_array_equal(after.spread[others][:, others], pairs.spread[others][:, others])
