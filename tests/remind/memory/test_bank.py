import dataclasses

import chex
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from remind_jax.numerics.absent import NEVER
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
    append,
    closest_pair,
    confidence,
    count_quality,
    empty_bank,
    live,
    mean_quality,
    move_toward,
    nearest,
    new_entry,
    remove,
    similarities,
    similarity_rate,
    write,
)

NOW = jnp.int32(9)
YES, NO = jnp.bool_(True), jnp.bool_(False)


def unit(degrees):
    return jnp.array([np.cos(np.radians(degrees)), np.sin(np.radians(degrees))], jnp.float32)


def bank_of(*vectors, last_seen=None, slots=4):
    """A bank with prototypes of one hit and quality 0.5."""
    vectors = [jnp.asarray(v, jnp.float32) for v in vectors]
    dim = vectors[0].shape[0] if vectors else 2
    bank = empty_bank((), slots, dim, jnp.dtype("float32"))
    for index, vector in enumerate(vectors):
        now = jnp.int32(index if last_seen is None else last_seen[index])
        bank = append(bank, new_entry(vector, jnp.float32(0.5), now), YES)
    return bank


def vectors_of(bank):
    return np.asarray(bank.embedding[: int(bank.size)])


def test_empty_bank_holds_nothing():
    bank = empty_bank((2, 3), 4, 5, jnp.dtype("float32"))
    assert bank.embedding.shape == (2, 3, 4, 5)
    assert not live(bank).any()
    assert (bank.last_seen == NEVER).all()
    one = bank_of()
    assert float(nearest(one, unit(0))[1]) == -np.inf
    assert float(closest_pair(one)[0]) == -1.0


def test_free_slots_are_never_nearest():
    """Their embedding is zero, which is closer to an opposite vector than the prototype is."""
    index, cosine = nearest(bank_of(unit(180)), unit(0))
    assert int(index) == 0
    np.testing.assert_allclose(cosine, -1, atol=1e-6)
    assert np.isneginf(similarities(bank_of(unit(180)), unit(0))[1:]).all()


def test_the_older_of_two_equals_is_nearest():
    assert int(nearest(bank_of(unit(10), unit(0), unit(0)), unit(0))[0]) == 1


def test_removal_keeps_the_order():
    bank = bank_of(unit(0), unit(10), unit(20))
    left = remove(bank, jnp.int32(1), YES)
    np.testing.assert_array_equal(vectors_of(left), [unit(0), unit(20)])
    assert left.last_seen[:2].tolist() == [0, 2]
    chex.assert_trees_all_equal(remove(bank, jnp.int32(1), NO), bank)


def test_writing_and_adding_only_when_told():
    bank = bank_of(unit(0), unit(10))
    value = new_entry(unit(90), jnp.float32(1), NOW)
    np.testing.assert_array_equal(vectors_of(write(bank, jnp.int32(0), value, YES))[0], unit(90))
    for same in (write(bank, jnp.int32(0), value, NO), append(bank, value, NO)):
        chex.assert_trees_all_equal(same, bank)
    assert append(bank, value, YES).size == 3


# Cosine, duplicate threshold, rates, scale, then the expected step and prototype
# (method.md#similarity-step).
UPDATES = [
    (0.94, 0.93, (0.03, 0.15), 1.0, 0.0, (1, 0)),
    (0.97, 0.93, (0.03, 0.15), 1.0, 0.078, (0.999819, 0.019003)),
    (0.97, 0.93, (0.02, 0.10), 0.5, 0.026, (0.999980, 0.006326)),
    (0.96, 0.95, (0.01, 0.05), 1.0, 0.0, (1, 0)),
    (0.98, 0.95, (0.01, 0.05), 0.6, 0.014, (0.999996, 0.002787)),
    (0.97, 0.93, (0.15, 0.03), 1.0, 0.078, (0.999819, 0.019003)),  # swapped rates are sorted
]


@pytest.mark.usefixtures("x64")
@pytest.mark.parametrize(("cosine", "duplicate", "rates", "scale", "step", "moved"), UPDATES)
def test_similarity_gated_steps_of_the_page(cosine, duplicate, rates, scale, step, moved):
    real = jnp.float64
    rate = similarity_rate(
        real(cosine), real(duplicate), real(0.02), real(rates[0]), real(rates[1]), real(scale)
    )
    np.testing.assert_allclose(rate, step, atol=1e-12)
    vector = jnp.array([cosine, np.sqrt(1 - cosine**2)], jnp.float32)
    reached = move_toward(unit(0), vector, rate)
    np.testing.assert_allclose(reached, moved, atol=1e-6)  # printed with six decimals
    if not step:
        np.testing.assert_array_equal(reached, unit(0))


def test_a_full_step_replaces_the_prototype():
    np.testing.assert_allclose(move_toward(unit(0), unit(33), jnp.float32(1)), unit(33), atol=1e-7)


def test_quality_is_a_mean_and_a_slower_mean():
    """method.md#prototype-quality: the rate is 1/n between 0.08 and 0.30."""
    value = new_entry(unit(0), jnp.float32(0.2), NOW)
    recent, qualities = 0.2, [0.2]
    for num in range(2, 16):
        value = count_quality(value, jnp.float32(num / 16))
        qualities.append(num / 16)
        rate = {2: 0.30, 3: 0.30, 13: 0.08, 14: 0.08, 15: 0.08}.get(num, 1 / num)
        recent = (1 - rate) * recent + rate * num / 16
        np.testing.assert_allclose(value.quality_recent, recent, rtol=1e-5)
        np.testing.assert_allclose(mean_quality(value), np.mean(qualities), rtol=1e-5)
    assert int(value.num_qualities) == 15


@pytest.mark.parametrize(
    ("hits", "promote_hits", "expected"), [(1, 5, 0.12), (5, 5, 0.6), (9, 5, 0.6), (2, 0, 0.3)]
)
def test_confidence_grows_with_hits(hits, promote_hits, expected):
    """method.md#prototype-quality: the better quality counts; four hits without promotion."""
    value = dataclasses.replace(
        new_entry(unit(0), jnp.float32(0.4), NOW),
        hits=jnp.int32(hits),
        quality_recent=jnp.float32(0.6),
    )
    np.testing.assert_allclose(confidence(value, jnp.int32(promote_hits)), expected, rtol=1e-6)


# method.md#bank-room.
CROWDED = ([1, 0, 0], [0.9, 0.43589, 0], [0, 0, 1])


@pytest.mark.parametrize(("redundant", "index"), [(True, 1), (False, 2)])
def test_eviction_example_of_the_page(redundant, index):
    bank = bank_of(*CROWDED, last_seen=(5, 3, 1))
    cosine, i, j, everything = closest_pair(bank)
    assert (int(i), int(j)) == (0, 1)
    np.testing.assert_allclose(cosine, 0.9, atol=1e-6)
    assert int(weakest(bank, everything, jnp.bool_(redundant))) == index


def test_the_first_of_equal_pairs_is_closest():
    _, i, j, _ = closest_pair(bank_of(unit(0), unit(90), unit(0), unit(90)))
    assert (int(i), int(j)) == (0, 2)


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
