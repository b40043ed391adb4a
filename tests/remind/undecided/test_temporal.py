"""Closeness, rankings and the temporal diagnosis (method.md#plausible-score)."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from remind_jax.decision import NUM_OPTIONS, Status
from remind_jax.remind.disambiguation.groups import Undecided
from remind_jax.remind.thresholds import Thresholds
from remind_jax.remind.undecided.temporal import judge, prefer

JUDGE = jax.jit(judge)


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
    rules = Thresholds().as_arrays(jnp.float64).ambiguous
    given_status, given_near, top = JUDGE(table, members, rules)
    assert int(given_status[0]) == status
    assert np.flatnonzero(given_near[0]).tolist() == near
    assert float(top[0]) == max(scores, default=0.0)


def test_the_first_entry_stands():
    def entries(present, number):
        options, row = jnp.full((3, NUM_OPTIONS), number), jnp.full(3, number)
        return Undecided(jnp.array(present), options, options.astype(float), row.astype(float), row)

    merged = prefer(entries([True, False, False], 1), entries([True, True, False], 2))
    assert merged.present.tolist() == [True, True, False]
    assert merged.best.tolist()[:2] == [1, 2]
    assert merged.slot.tolist()[:2] == [[1] * 3, [2] * 3]
