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
from tests.remind.association.tables import NUM, SLOTS, decide_frames, visual_frame

LOCK = jax.jit(lock_pairs)


def lock(score: np.ndarray, eligible: np.ndarray, t: Matching) -> tuple[np.ndarray, np.ndarray]:
    pairs = dataclasses.replace(initial_pairs(jnp.asarray(score)), eligible=jnp.asarray(eligible))
    return jax.device_get(LOCK(pairs, jnp.asarray(score), jax.tree.map(jnp.asarray, t)))


def lock_plainly(
    score: np.ndarray, eligible: np.ndarray, t: Matching
) -> dict[int, tuple[int, Lock]]:
    """method.md#locks, pair by pair."""

    def clear(values: list[float]) -> bool:
        first, second = [*sorted(values, reverse=True), 0.0][:2]
        lead = first - second
        return (
            first >= t.lock_score
            and lead >= t.lock_gap
            and lead / max(1e-12, first) >= t.lock_relative_gap
        )

    def accept(proposals: list[tuple[int, int]], kind: Lock) -> None:
        for n, o in sorted(proposals, key=lambda pair: -score[pair]):
            if n not in locked and o not in {slot for slot, _ in locked.values()}:
                locked[n] = (o, kind)

    locked: dict[int, tuple[int, Lock]] = {}
    num, slots = score.shape
    proposals = []
    for o in range(slots):
        rows = [n for n in range(num) if eligible[n, o]]
        if t.object_locks and rows and clear([score[n, o] for n in rows]):
            proposals.append((max(rows, key=lambda n: score[n, o]), o))
    accept(proposals, Lock.OBJECT)
    proposals = []
    taken = {slot for slot, _ in locked.values()}
    for n in range(num):
        columns = [o for o in range(slots) if eligible[n, o] and o not in taken]
        if n not in locked and columns and clear([score[n, o] for o in columns]):
            proposals.append((n, max(columns, key=lambda o: score[n, o])))
    accept(proposals, Lock.DETECTION)
    return locked


def test_locks_are_those_of_the_plain_rule(x64):
    rng, seen = np.random.default_rng(0), set()
    for _ in range(300):
        score = rng.choice([0.3, 0.76, 0.8, 0.91, 0.95, 0.97], (4, 5))
        if rng.random() < 0.5:
            score = score + rng.uniform(0, 0.02, score.shape)
        eligible = (score >= 0.75) & (rng.random(score.shape) < 0.6)
        t = Matching(object_locks=bool(rng.random() < 0.7), lock_gap=float(rng.choice([0, 0.1])))
        pairs, kind = lock(score, eligible, t)
        expected = lock_plainly(score, eligible, t)
        found = {int(n): (int(o), Lock(kind[n])) for n, o in np.argwhere(pairs)}
        assert found == expected
        seen |= {k for _, k in expected.values()}
    assert seen == {Lock.OBJECT, Lock.DETECTION}


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


def test_no_object_is_given_twice_and_all_given_pass_the_threshold(x64):
    rng = np.random.default_rng(1)
    frames = [
        visual_frame([dict(enumerate(row)) for row in rng.uniform(0.6, 1, (NUM, SLOTS))])
        for _ in range(64)
    ]
    verdict = decide_frames(frames)
    for slots, scores in zip(verdict.assignment.slot, verdict.assignment.score, strict=True):
        given = slots[slots >= 0]
        assert len(set(given)) == len(given)
        assert (scores[slots >= 0] >= 0.75).all()
        assert (scores[slots < 0] == 0).all()


def test_a_penalty_can_reject_the_pair_that_was_chosen(x64):
    said = {0: {"bonus_raw": -0.05, "score_sets": -1.0}}
    verdict = decide_frames([visual_frame([{0: 0.78}], context=said), visual_frame([{0: 0.78}])])
    assert verdict.assignment.slot[:, 0].tolist() == [-1, 0]
