import dataclasses

import chex
import jax.numpy as jnp
import numpy as np
import pytest

from remind_jax.numerics.absent import NEVER
from remind_jax.remind.memory.prototypes import (
    closest_pair,
    confidence,
    count_quality,
    empty_bank,
    keep_rows,
    live,
    mean_quality,
    move_toward,
    nearest,
    new_entry,
    similarities,
    similarity_rate,
)
from tests.remind.memory.small_banks import (
    NOW,
    append,
    bank_of,
    edited,
    unit,
    vectors_of,
    with_records,
)


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
    value = with_records(new_entry(unit(0), jnp.float32(0.4), NOW), hits=hits, quality_recent=0.6)
    np.testing.assert_allclose(confidence(value, jnp.int32(promote_hits)), expected, rtol=1e-6)


def test_the_first_of_equal_pairs_is_closest():
    _, i, j, _ = closest_pair(bank_of(unit(0), unit(90), unit(0), unit(90)))
    assert (int(i), int(j)) == (0, 2)


def test_only_the_kept_rows_keep_their_banks():
    bank = empty_bank((2, 1, 3), 2, 2, jnp.dtype("float32"))
    full = dataclasses.replace(bank, size=jnp.array([[[2, 1, 2]]] * 2))
    kept = keep_rows(full, jnp.array([True, False, True]))
    assert kept.work.size.tolist() == kept.stable.size.tolist() == [[2, 0, 2]]
