"""Locks of clear wins and the joint assignment (method.md#locks, method.md#joint-assignment)."""

from __future__ import annotations

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from remind_jax.remind.association.assignment import dummy_scores, lock_pairs
from remind_jax.remind.association.diagnosis import Evidence
from remind_jax.remind.association.gating import initial_pairs
from remind_jax.remind.stages import Lock
from remind_jax.remind.thresholds.association import Matching

LOCK = jax.jit(lock_pairs)


def lock(score: np.ndarray, eligible: np.ndarray, t: Matching) -> tuple[np.ndarray, np.ndarray]:
    pairs = dataclasses.replace(initial_pairs(jnp.asarray(score)), eligible=jnp.asarray(eligible))
    return jax.device_get(LOCK(pairs, jnp.asarray(score), jax.tree.map(jnp.asarray, t)))


@pytest.mark.parametrize(
    ("scores", "locked"),
    [([0.91, 0.74], True), ([0.91, 0.85], False), ([0.89, 0.75], False), ([0.95, 0.85], False)],
)
def test_lock_needs_score_and_lead(x64, scores, locked):
    # 0.95 - 0.85 is just below 0.10 in doubles.
    pairs, _ = lock(np.array([scores]), np.ones((1, 2), bool), Matching(object_locks=False))
    assert pairs.any() == locked


def test_locks_can_be_switched_off(x64):
    pairs, kind = lock(np.array([[0.99]]), np.ones((1, 1), bool), Matching(locks=False))
    assert not pairs.any()
    assert kind.tolist() == [Lock.NONE]


def test_uncertain_detections_give_way(x64):
    """The example of method.md#dummy-columns."""

    def price(confidence: float, status: int = 2, **changed: float) -> float:
        one = jnp.ones(1)
        evidence = Evidence(jnp.full(1, status), one, one, one, jnp.array([confidence]))
        t = jax.tree.map(jnp.asarray, dataclasses.replace(Matching(), **changed))
        return float(dummy_scores(evidence, t)[0])

    assert price(0.001238) == pytest.approx(0.249752, abs=1e-6)
    assert price(0.230310) == pytest.approx(0.203938, abs=1e-6)
    assert price(1.0) == pytest.approx(0.05)
    assert price(0.0, dummy_score=0.7) == 0.72  # capped
    assert (
        price(0.0, dummy_score=0.9, dummy_by_confidence=False) == 0.9
    )  # the cap is another rule's
    assert price(0.0, status=0) == pytest.approx(0.05)  # without a diagnosis
