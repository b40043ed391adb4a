"""Status, confidence and anchors (method.md#reliable-anchors, method.md#status)."""

from __future__ import annotations

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from remind_jax.decision import Status
from remind_jax.remind.association.diagnosis import Evidence, diagnose, find_anchors, top_two
from remind_jax.remind.thresholds.association import Diagnosis

DIAGNOSE = jax.jit(diagnose, static_argnames="margin")
ANCHORS = jax.jit(find_anchors)
WIDTH = 4


def table(*rows: list[float]) -> tuple[np.ndarray, np.ndarray]:
    scores, counted = np.zeros((len(rows), WIDTH)), np.zeros((len(rows), WIDTH), bool)
    for n, row in enumerate(rows):
        scores[n, : len(row)], counted[n, : len(row)] = row, True
    return scores, counted


def look(
    *scores: float, num_terms: int = 1, margin: str = "sigmoid", **changed: object
) -> Evidence:
    t = jax.tree.map(jnp.asarray, dataclasses.replace(Diagnosis(), **changed))  # pyright: ignore[reportArgumentType]
    evidence = DIAGNOSE(*table(list(scores)), np.array([num_terms], np.int32), margin, t)
    return jax.tree.map(lambda leaf: leaf[0].item(), evidence)


@pytest.mark.parametrize(
    ("scores", "status", "num_close"),
    [
        ((), Status.WEAK, 0),
        ((0.80,), Status.STRONG, 1),
        ((0.79,), Status.AMBIGUOUS, 1),
        ((0.75,), Status.AMBIGUOUS, 1),
        ((0.74,), Status.WEAK, 1),
        ((0.90, 0.81), Status.STRONG, 1),
        ((0.90, 0.83), Status.AMBIGUOUS, 1),
        ((0.90, 0.88, 0.87), Status.AMBIGUOUS, 3),
        ((0.50, 0.49), Status.WEAK, 2),
        ((0.0,), Status.WEAK, 1),
    ],
)
def test_status(x64, scores, status, num_close):
    evidence = look(*scores)
    assert (evidence.status, evidence.num_close) == (status, num_close)
    first, second = [*sorted(scores, reverse=True), 0, 0][:2]
    assert (evidence.best_score, evidence.second_score) == (first, second)


def test_margin_kinds(x64):
    lead = 1 / (1 + np.exp(-0.2 / 0.05))
    distinct = (0.9 - 0.7) / 0.3
    rest = 0.9 * lead * distinct
    for margin, value in (
        ("linear", 0.2),
        ("linear_relative", 0.2 / 0.9),
        ("sigmoid", 1 / (1 + np.exp(-(0.2 - 0.1) / 0.05))),
        ("sigmoid_relative", 1 / (1 + np.exp(-(0.2 / 0.9 - 0.1) / 0.05))),
    ):
        evidence = look(0.9, 0.7, num_terms=4, margin=margin)
        assert evidence.confidence == pytest.approx(rest * value, rel=1e-9), margin


def test_divisors_too_small_are_replaced(x64):
    """method.md#confidence: what does not exceed `small` gives way."""

    def confidence(**changed: float) -> float:
        return look(0.8, 0.7, num_terms=3, **changed).confidence  # pyright: ignore[reportReturnType]

    assert confidence(temperature=1e-9, temperature_least=0.3) == confidence(temperature=0.3)
    assert confidence(gap_scale=1e-9, gap_scale_least=0.3) == confidence(gap_scale=0.3)
    # 1 - 0.7, the room above the others, is divided by only as far as it exceeds `small`.
    wide = {"temperature": 0.7, "gap_scale": 0.7}
    assert confidence(small=0.6, **wide) == pytest.approx(confidence(**wide) * 0.3 / 0.6)


def test_switches():
    assert look(0.9, enabled=False).status == Status.NONE
    assert look(0.9, confidence_enabled=False).confidence == 0.0


scores = st.lists(st.floats(0, 1, width=32), max_size=WIDTH)


@given(scores)
def test_evidence_does_not_depend_on_the_order_of_candidates(values):
    ours, theirs = look(*values), look(*values[::-1])
    assert (ours.status, ours.num_close) == (theirs.status, theirs.num_close)
    # Sums run in another order.
    assert ours.confidence == pytest.approx(theirs.confidence, abs=1e-6)
    assert 0 <= ours.confidence <= 1


def test_top_two_take_the_first_of_equals():
    best, top, second = top_two(*table([0.5, 0.7, 0.7], [0.2], []))
    assert best.tolist()[:2] == [1, 0]
    np.testing.assert_allclose(top, [0.7, 0.2, 0])
    np.testing.assert_allclose(second, [0.7, 0, 0])


def anchors(*rows: list[float]) -> list[tuple[int, int]]:
    found = ANCHORS(*table(*rows), jax.tree.map(jnp.asarray, Diagnosis()))
    return [(int(n), int(o)) for n, o in np.argwhere(found)]


def test_anchors_are_clear(x64):
    assert anchors([0.75, 0.60]) == [(0, 0)]
    assert anchors([0.74]) == []
    assert anchors([0.80, 0.73]) == []
    assert anchors([0.2, 0.9], [0.9, 0.2]) == [(0, 1), (1, 0)]


def test_one_anchor_per_object_the_better_one_then_the_first(x64):
    assert anchors([0.80], [0.90], [0.85]) == [(1, 0)]
    assert anchors([0.90], [0.90]) == [(0, 0)]
