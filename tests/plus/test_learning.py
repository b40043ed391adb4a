"""What decided detections teach: kept looks, births, relations."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from remind_jax.numerics.absent import NO_SLOT
from remind_jax.plus import learning, slots
from remind_jax.plus.learning import KeptLooks
from remind_jax.plus.slots import NO_ROW
from remind_jax.plus.state import UNRELATED
from tests.plus.frames import STATIC, TICK, T, detections, empty_state, objects_of, tracklets_of

X, Y = np.eye(3, dtype=np.float32)[:2]
create_objects = jax.jit(slots.create_objects)
keep_looks, learn_relations = jax.jit(learning.keep_looks), jax.jit(learning.learn_relations)
SURE = jnp.array([True, True, False])
EVERYONE = jnp.array([0, 1, 2, NO_ROW])  # detection of each object


def keep(objects, slot, look):
    """One look kept of one object; the other detections keep nothing."""
    nothing = KeptLooks(jnp.zeros(2, jnp.int32), jnp.zeros((2, 3)), jnp.zeros(2, bool))
    one = KeptLooks(jnp.array([slot]), jnp.asarray(look, jnp.float32)[None], jnp.array([True]))
    return keep_looks(objects, empty_state().scene, (nothing, one), T.memory)


def test_a_close_look_joins_the_nearest_kept_one():
    after = keep(objects_of([X]), 0, 1.2 * X)
    assert after.bank_count[0].tolist()[:2] == [2, 0]
    np.testing.assert_allclose(after.bank[0, 0], 1.1 * X, rtol=1e-6)
    np.testing.assert_allclose(after.white_bank[0, 0], X, rtol=1e-5)


def test_a_new_look_is_added_where_there_is_room():
    after = keep(objects_of([X]), 0, Y)
    assert after.bank_count[0].tolist()[:3] == [1, 1, 0]
    np.testing.assert_allclose(after.bank[0, 1], Y)


def test_a_batch_keeps_looks_as_its_members_do_alone():
    rng = np.random.default_rng(0)
    objects, scene = objects_of([X, Y]), empty_state().scene
    looks = jnp.asarray(rng.normal(size=(5, 4, 3)), jnp.float32)
    slots = jnp.asarray(rng.integers(0, 2, (5, 4)), jnp.int32)
    keeps = jnp.asarray(rng.random((5, 4)) < np.linspace(0, 1, 5)[:, None])

    def show(slot, look, keeps):
        halves = (
            KeptLooks(slot[:3], look[:3], keeps[:3]),
            KeptLooks(slot[3:], look[3:], keeps[3:]),
        )
        return learning.keep_looks(objects, scene, halves, T.memory)

    together = jax.jit(jax.vmap(show))(slots, looks, keeps)
    for member in range(5):
        alone = jax.jit(show)(slots[member], looks[member], keeps[member])
        jax.tree.map(
            lambda one, other, m=member: np.testing.assert_allclose(one[m], other, atol=1e-6),
            together,
            alone,
        )


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
    after, pairs, slot = create_objects(
        gap, empty_state().pairs, begun, born, jnp.full(3, 0.2), jnp.full(3, 0.1)
    )
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
    return objects, learn_relations(objects, state.pairs, EVERYONE, seen, TICK, T.mobility)


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
    two = jnp.array([0, 1, NO_ROW, NO_ROW])
    after = learn_relations(objects, lost, two, seen, TICK, T.mobility)
    np.testing.assert_allclose(after.relation[0, 2], pairs.relation[0, 2])
    assert after.covisible[0, 2] == pairs.covisible[0, 2]
    assert after.covisible[0, 1] == pairs.covisible[0, 1] + 1


@pytest.mark.parametrize("slot", range(3))
def test_what_was_known_of_an_object_that_is_gone_is_forgotten_from_both_sides(slot):
    objects, pairs = related_pairs()
    left = dataclasses.replace(objects, id=objects.id.at[slot].set(-1))
    nobody = jnp.full(STATIC.num_objects, NO_ROW)
    after = learn_relations(left, pairs, nobody, detections([[1, 1]] * 3), TICK, T.mobility)
    for name, blank in (("spread", UNRELATED), ("covisible", 0), ("relation", 0), ("log_ratio", 0)):
        now, before = np.asarray(getattr(after, name)), np.asarray(getattr(pairs, name))
        assert (now[slot] == blank).all(), name
        assert (now[:, slot] == blank).all(), name
        others = [other for other in range(3) if other != slot]
        np.testing.assert_array_equal(now[np.ix_(others, others)], before[np.ix_(others, others)])


def test_an_object_keeps_every_other_look_and_its_first():
    objects = objects_of([X, Y])
    bare = dataclasses.replace(objects, bank_count=objects.bank_count.at[1].set(0))
    here = tracklets_of(detections([[1, 1]] * 3), 0, 3, slot=jnp.array([0, 1, NO_SLOT]))
    for age in (2, 3):
        aged = dataclasses.replace(here, age=jnp.full(3, age))
        looks = KeptLooks.in_view(bare, aged, SURE, SURE, detections([[1, 1]] * 3))
        assert looks.keeps.tolist() == [age % learning.KEEP_EVERY == 1, True, False]


def test_what_the_border_cuts_off_is_kept_of_new_things_and_of_those_seen_for_long():
    seen = detections([[1, 1]] * 2, touches=np.array([True, False]))
    here = tracklets_of(seen, 0, 2, slot=jnp.arange(2))
    for age, is_kept in ((7, True), (9, False), (39, False), (41, True)):
        aged = dataclasses.replace(here, age=jnp.full(2, age))
        looks = KeptLooks.in_view(objects_of([X, Y]), aged, seen.valid, seen.valid, seen)
        assert looks.keeps.tolist() == [is_kept, True]
