import numpy as np
import pytest

from remind_jax.errors import RemindError
from remind_jax.metrics.combine import (
    bootstrap_intervals,
    pool_counts,
    resample_counts,
    stack_counts,
    sum_counts,
)
from remind_jax.metrics.identity import IdentityCounts, identity_scores
from tests.metrics.tables import count_identity, random_sequence

SEQUENCES = [random_sequence(seed) for seed in range(8)]


def test_resamples_are_pools_of_drawn_units():
    units = [IdentityCounts(*(np.asarray(v) for v in (10**i, 0, 1))) for i in range(5)]
    drawn = resample_counts(stack_counts(units), num_resamples=50, seed=3)
    assert drawn.true_positives.shape == (50,)
    assert (drawn.false_positives == 5).all()
    digits = [[int(c) for c in str(int(v))] for v in drawn.true_positives]
    assert all(sum(d) == 5 for d in digits)


def test_intervals_hold_the_pooled_score_and_repeat():
    stacked = stack_counts(count_identity(sequence) for sequence in SEQUENCES)
    pooled = float(identity_scores(sum_counts(stacked))["IDF1"])
    intervals = bootstrap_intervals(stacked, identity_scores, seed=1)
    low, high = intervals["IDF1"]
    assert low < pooled < high
    assert bootstrap_intervals(stacked, identity_scores, seed=1) == intervals
    assert bootstrap_intervals(stacked, identity_scores, seed=2)["IDF1"] != (low, high)
    narrow = bootstrap_intervals(stacked, identity_scores, level=0.5, seed=1)["IDF1"]
    assert low < narrow[0] < narrow[1] < high


def test_nothing_cannot_be_combined():
    with pytest.raises(RemindError, match="nothing to combine"):
        pool_counts([])
    with pytest.raises(RemindError, match="level is 95"):
        bootstrap_intervals(count_identity(SEQUENCES[0]), identity_scores, level=95)
    with pytest.raises(RemindError, match="num_resamples is 0; give 1 or more"):
        bootstrap_intervals(count_identity(SEQUENCES[0]), identity_scores, num_resamples=0)
