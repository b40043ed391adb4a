"""The best pair first, held against a plain loop."""

import jax
import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from remind_jax.solvers.greedy import assign_greedily

ASSIGN = jax.jit(assign_greedily)


def assign_plainly(scores, allowed, dummy, dummies):
    column = np.full(len(scores), -1)
    pairs = [
        (-scores[row, to], row, to)
        for row, to in zip(*np.nonzero(allowed), strict=True)
        if not dummies or scores[row, to] >= dummy[row]
    ]
    for _, row, to in sorted(pairs):
        if column[row] < 0 and to not in column:
            column[row] = to
    return column


@given(seed=st.integers(0, 2**32 - 1), dummies=st.booleans())
def test_equals_a_plain_loop(seed, dummies):
    """Scores of few values, so that ties are common."""
    rng = np.random.default_rng(seed)
    scores = rng.integers(0, 5, (5, 7)) / 4.0
    allowed = rng.random((5, 7)) < rng.choice([0.0, 0.3, 0.9])
    dummy = rng.integers(0, 3, 5) / 4.0
    column = ASSIGN(scores, allowed, dummy, dummies)
    np.testing.assert_array_equal(column, assign_plainly(scores, allowed, dummy, dummies))


def test_the_best_pair_goes_first_even_where_the_sum_would_be_larger():
    scores = np.array([[0.9, 0.8], [0.85, 0.1]])
    column = ASSIGN(scores, np.ones((2, 2), bool), np.zeros(2), True)
    assert column.tolist() == [0, 1]  # 0.9 + 0.1, while 0.8 + 0.85 were possible
