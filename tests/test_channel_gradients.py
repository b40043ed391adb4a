"""Gradients find the channel that tells objects apart, and the threshold between known and new."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from benchmarks.gradients import Candidates, fit_weights, surrogate_loss
from remind_jax.config import Config

THRESHOLDS = Config().thresholds
_loss = jax.jit(surrogate_loss)


def made_up(number=400, telling=1, seed=0):
    """Candidates of which one term tells the right one, at 0.8 to 0.6; the others are noise."""
    random = np.random.default_rng(seed)
    value = random.uniform(0.5, 0.9, (number, 4, 3))
    right = np.zeros((number, 4), bool)
    known = random.random(number) < 0.7
    right[known, random.integers(0, 4, known.sum())] = True
    value[..., telling] = np.where(right, 0.8, 0.6) + random.normal(0, 0.02, right.shape)
    shown = right | (random.random(right.shape) < 0.8)
    arrays = (value, np.ones_like(value), shown, right)
    return Candidates(*(jnp.asarray(a) for a in arrays))


@pytest.mark.parametrize("telling", [0, 1, 2])
def test_the_channel_that_tells_gets_the_weight(telling):
    fit = fit_weights(made_up(telling=telling), THRESHOLDS)
    names = ("object_weight", "background_weight", "parts_weight")
    weights = [fit.setting[f"similarity.{name}"] for name in names]
    start = THRESHOLDS.similarity
    assert sum(weights) == pytest.approx(sum(getattr(start, name) for name in names), abs=1e-4)
    assert weights[telling] > 0.8 * sum(weights)
    assert 0.65 < fit.setting["matching.match"] < 0.75
    assert fit.loss[-1] < min(0.3, 0.5 * fit.loss[0])  # log 5 = 1.6 is knowing nothing


def test_a_weight_of_zero_stays_there_and_a_missing_term_does_not_count():
    candidates = made_up()
    without = Candidates(
        candidates.value,
        candidates.factor.at[..., 2].set(0.0),
        candidates.shown,
        candidates.right,
    )
    changed = Candidates(
        without.value.at[..., 2].set(0.123), without.factor, without.shown, without.right
    )
    weights, match = jnp.array([0.5, 0.3, 0.2]), jnp.float32(0.7)
    assert _loss(without, weights, match, 0.05) == _loss(changed, weights, match, 0.05)
    zero = Config().updated({"thresholds": {"similarity": {"parts_weight": 0.0}}}).thresholds
    assert "similarity.parts_weight" not in fit_weights(candidates, zero, num_steps=5).setting
