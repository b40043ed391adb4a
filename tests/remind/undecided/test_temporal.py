"""Closeness, rankings and the temporal diagnosis (method.md#plausible-score)."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from remind_jax.decision import NUM_OPTIONS, Status
from remind_jax.numerics.absent import NO_SLOT
from remind_jax.remind.disambiguation.groups import Undecided
from remind_jax.remind.undecided.temporal import judge, prefer, rank, to_mask

AMBIGUOUS = (0.45, 0.40, 0.05, 0.10, 1e-4)  # least top and candidate score, gaps, slack
JUDGE = jax.jit(judge)
RANK = jax.jit(rank, static_argnames="later_first")


@pytest.mark.parametrize(
    ("scores", "status", "near"),
    [
        ([], Status.WEAK, []),
        ([0.44], Status.WEAK, [0]),
        ([0.46], Status.STRONG, [0]),
        ([0.80, 0.73], Status.AMBIGUOUS, [0, 1]),
        ([0.80, 0.7195], Status.STRONG, [0]),
        ([0.42, 0.44, 0.46], Status.AMBIGUOUS, [0, 1, 2]),
        ([0.46, 0.39], Status.STRONG, [0]),  # below the least score of a candidate
    ],
)
def test_diagnosis(x64, scores, status, near):
    table = np.zeros((1, 3))
    table[0, : len(scores)] = scores
    members = np.arange(3)[None] < len(scores)
    given_status, given_near, top = JUDGE(table, members, *map(jnp.float64, AMBIGUOUS))
    assert int(given_status[0]) == status
    assert np.flatnonzero(given_near[0]).tolist() == near
    assert float(top[0]) == max(scores, default=0.0)


tables = st.lists(
    st.lists(st.sampled_from([0.1, 0.2, 0.3, 0.5, 0.9]), min_size=6, max_size=6),
    min_size=2,
    max_size=2,
)


@given(tables, st.integers(0, 2**12 - 1), st.integers(0, 4), st.booleans())
def test_rank_is_a_stable_sort(scores, bits, most, later_first):
    scores = np.array(scores)
    members = np.array([bits >> k & 1 for k in range(12)], bool).reshape(2, 6)
    slots, values = RANK(scores, members, jnp.int32(most), later_first=later_first)
    for row in range(2):
        sign = -1 if later_first else 1
        order = sorted(np.flatnonzero(members[row]), key=lambda o: (-scores[row, o], sign * o))
        expected = order[: min(most, NUM_OPTIONS)]
        lacking = NUM_OPTIONS - len(expected)
        assert slots[row].tolist() == expected + [NO_SLOT] * lacking
        np.testing.assert_allclose(values[row], [*scores[row, expected], *[0.0] * lacking])


def test_rank_of_fewer_objects_than_options():
    slots, scores = rank(jnp.array([[0.5]]), jnp.array([[True]]))
    assert slots.tolist() == [[0, NO_SLOT, NO_SLOT]]
    assert scores.tolist() == [[0.5, 0, 0]]


def test_padding_and_virtual_slots_mark_nothing():
    mask = to_mask(jnp.array([[2, NO_SLOT, 4], [NO_SLOT] * 3]), 4)
    assert mask.tolist() == [[False, False, True, False], [False] * 4]


def test_the_first_entry_stands():
    def entries(present, number):
        options, row = jnp.full((3, NUM_OPTIONS), number), jnp.full(3, number)
        return Undecided(jnp.array(present), options, options.astype(float), row.astype(float), row)

    merged = prefer(entries([True, False, False], 1), entries([True, True, False], 2))
    assert merged.present.tolist() == [True, True, False]
    assert merged.best.tolist()[:2] == [1, 2]
    assert merged.slot.tolist()[:2] == [[1] * 3, [2] * 3]
