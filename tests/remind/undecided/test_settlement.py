"""Whole frames: the examples of docs/method.md, frozen frames of the original's rules, and what
holds for any frame."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any

import jax
import numpy as np
import pytest

from remind_jax.decision import Outcome, Reason, Status
from remind_jax.remind.memory.objects import Lifecycle
from tests.remind.association.frozen_frames import load_expected, load_frames, load_thresholds
from tests.remind.association.tables import (
    BATCH,
    NUM,
    SLOTS,
    Frame,
    Verdict,
    backed,
    decide_frames,
    visual_frame,
)

MATCH, NEW, AMBIGUOUS = Outcome.MATCH, Outcome.NEW, Outcome.AMBIGUOUS
PARENT, PROVISIONAL = Outcome.PROVISIONAL_PARENT, Outcome.PROVISIONAL_NEW
STABILITY = Reason.KNOWN_BUT_AMBIGUOUS_IDENTITY_STABILITY
COMPETITION = Reason.KNOWN_AND_COMMITTED_NEW_COMPETITION

Known = dict[int, float]


def one(outcome: Outcome, known: Known | None = None, **more: Any) -> dict[str, Any]:
    """What is expected of one detection; `known` gives the objects named, in order, with scores."""
    return {"outcome": outcome, "known": known or {}, **more}


def match(slot: int, score: float | None = None, **more: Any) -> dict[str, Any]:
    return one(MATCH, object=slot, **({} if score is None else {"score": score}), **more)


INACTIVE: dict[str, Any] = {"lifecycle": Lifecycle.INACTIVE}
VISUAL = Reason.KNOWN_BUT_AMBIGUOUS_VISUAL_MATCH

# Number in method.md#example-frames: visual scores per detection, surroundings, what is expected.
EXAMPLES: dict[str, tuple[list[Known], dict[str, Any], list[dict[str, Any]]]] = {
    "1": ([{0: 0.78}], {}, [match(0, 0.78, status=Status.AMBIGUOUS, confidence=0.253500)]),
    "2": ([{0: 0.91}], {}, [match(0, 0.91, status=Status.STRONG, confidence=0.345042)]),
    "3": ([{0: 0.91, 1: 0.74}], {}, [match(0, status=Status.STRONG, confidence=0.192452)]),
    "4": (
        [{0: 0.91, 1: 0.85}],
        {},
        [one(AMBIGUOUS, {0: 0.91, 1: 0.85}, status=Status.AMBIGUOUS, reason=VISUAL)],
    ),
    "5": ([{0: 0.80, 1: 0.73}], {}, [one(AMBIGUOUS, {0: 0.80, 1: 0.73})]),
    "6": ([{0: 0.80, 1: 0.7195}], {}, [match(0, status=Status.STRONG)]),
    "7": (
        [{0: 0.80, 1: 0.79, 2: 0.775}],
        {},
        [one(AMBIGUOUS, {0: 0.80, 1: 0.79, 2: 0.775})],
    ),
    "8": ([{0: 0.88, 1: 0.70}, {0: 0.72, 1: 0.86}], {}, [match(0), match(1)]),
    "9": (
        [{0: 0.88, 1: 0.80}, {0: 0.87, 1: 0.76}],
        {},
        [
            one(AMBIGUOUS, {0: 0.88, 1: 0.80}, reason=STABILITY, assigned=1),
            one(AMBIGUOUS, {0: 0.87, 1: 0.76}, reason=STABILITY, assigned=0),
        ],
    ),
    "10": (
        [{0: 0.80, 1: 0.79}, {0: 0.78, 1: 0.78}],
        {},
        [
            one(AMBIGUOUS, {0: 0.80, 1: 0.79}, reason=STABILITY),
            one(AMBIGUOUS, {1: 0.78, 0: 0.78}, reason=STABILITY),
        ],
    ),
    "11": (
        [{0: 0.93}, {0: 0.90}],
        {},
        [one(AMBIGUOUS, {0: 0.93, 1: 0.93}, reason=COMPETITION, score=0.93)] * 2,
    ),
    "12": (
        [{0: 0.93}, {0: 0.90}],
        {"lifecycle": Lifecycle.TENTATIVE, "age": 3},
        [match(0), one(NEW)],
    ),
    "13": (
        [{0: 0.95}, {0: 0.91}],
        {},
        [one(AMBIGUOUS, {0: 0.95, 1: 0.95}, reason=COMPETITION)] * 2,
    ),
    "14": ([{0: 0.89}, {0: 0.85}], {}, [match(0), one(NEW)]),
    "15": ([{0: 0.93}, {0: 0.91}, {0: 0.90}], {}, [match(0), one(NEW), one(NEW)]),
    "16": ([{0: 0.80}, {0: 0.80}], INACTIVE, [match(0), one(NEW)]),
    "17": (
        [{0: 0.80, 1: 0.79}, {0: 0.79}, {1: 0.95}],
        INACTIVE,
        [one(NEW), match(0), match(1)],
    ),
    "18": ([{0: 0.74, 1: 0.50}], {}, [one(PARENT, {0: 0.74}, reason=Reason.UNCERTAIN_PARENT)]),
    "19a": ([{0: 0.73}], {}, [one(NEW)]),
    "19b": ([{0: 0.7301}], {}, [one(PARENT, {0: 0.7301})]),
    "20": (
        [{0: 0.95}, {0: 0.74}],
        {},
        [match(0), one(PROVISIONAL, {0: 0.74}, reason=Reason.UNCERTAIN_KNOWN_BLOCKED, blocked=1)],
    ),
    "21": ([{0: 0.50}], {}, [one(NEW, score=0.0)]),
    "22": (
        [{0: 0.66, 1: 0.55}],
        {"context": {0: backed(0.10)}},
        [match(0, 0.76, status_final=Status.AMBIGUOUS)],
    ),
    "23": (
        [{0: 0.78}],
        {"context": {0: {"bonus_raw": -0.05, "score_sets": -1.0}}},
        [one(NEW)],
    ),
    "24": (
        [{0: 0.64, 1: 0.30}],
        {"context": {0: backed(0.05)}},
        [one(PARENT, {0: 0.69}, score=0.69)],
    ),
    "25": (
        [{0: 0.95}, {0: 0.70}],
        {"context": {0: backed(0.05)}},
        [match(0, 0.95), one(PROVISIONAL, {0: 0.75}, score=0.75, blocked=1)],
    ),
    "26": (
        [{0: 0.84, 1: 0.78}],
        {"context": {1: backed(0.05)}},
        [one(AMBIGUOUS, {0: 0.84, 1: 0.83}, reason=VISUAL)],
    ),
    "27": ([{0: 0.92, 1: 0.76}], {"context": {1: backed(0.05)}}, [match(0)]),
    "28": (
        [{0: 0.66, 1: 0.65}],
        {"context": {0: backed(0.05), 1: backed(0.05)}},
        [one(AMBIGUOUS, {0: 0.71, 1: 0.70}, reason=Reason.KNOWN_BUT_AMBIGUOUS, assigned=-1)],
    ),
    "29": (
        [{0: 0.71, 1: 0.70}],
        {"context": {0: backed(0.05), 1: backed(0.05)}},
        [one(AMBIGUOUS, {0: 0.76, 1: 0.75}, reason=Reason.KNOWN_BUT_AMBIGUOUS_MATCH, assigned=0)],
    ),
    "30": (
        [{0: 0.95, 1: 0.30}, {0: 0.80, 1: 0.66}],
        {"context": {0: backed(0.05), 1: backed(0.05)}, **INACTIVE},
        [
            match(0),
            one(
                AMBIGUOUS,
                {0: 0.85, 1: 0.71},
                reason=Reason.KNOWN_BUT_AMBIGUOUS_CONTEXTUAL_FALLBACK,
            ),
        ],
    ),
    "31": (
        [{0: 0.95, 1: 0.20}, {0: 0.85, 1: 0.70}],
        {"context": {1: backed(0.08)}},
        [match(0), match(1, 0.78, status=Status.STRONG)],
    ),
}


def check(verdict: Verdict, row: int, n: int, expected: Mapping[str, Any]) -> None:
    d = verdict.decisions
    assert Outcome(d.outcome[row, n]) is expected["outcome"]
    for field, values in (
        ("reason", d.reason),
        ("status", d.status),
        ("status_final", d.status_final),
        ("object", d.object_id),
        ("assigned", d.assigned_id),
    ):
        if field in expected:
            assert values[row, n] == expected[field], field
    # Scores pass through one weighted mean: off by an ulp; six decimals are given.
    for field, values in (("score", d.score), ("confidence", d.confidence)):
        if field in expected:
            assert values[row, n] == pytest.approx(expected[field], abs=5e-7), field
    named = [int(slot) for slot in d.option_id[row, n] if slot >= 0]
    assert named == list(expected["known"])
    scores = d.option_score[row, n, : len(named)]
    np.testing.assert_allclose(scores, list(expected["known"].values()), atol=1e-9)
    assert d.option_blocked[row, n].sum() == expected.get("blocked", 0)


def test_worked_examples(x64):
    frames = [visual_frame(rows, **around) for rows, around, _ in EXAMPLES.values()]
    verdict = decide_frames(frames)
    failed = []
    for row, (name, (_, _, expected)) in enumerate(EXAMPLES.items()):
        for n, about in enumerate(expected):
            try:
                check(verdict, row, n, about)
            except AssertionError as error:
                failed.append(f"example {name}, detection {n}: {error}")
    assert not failed, "\n".join(failed)


def test_frozen_frames(x64):
    """128 frames with every reason, half of them with thresholds of their own."""
    expected = load_expected()
    verdict = decide_frames(load_frames(), load_thresholds())
    d, pairs = verdict.decisions, verdict.assignment.pairs
    candidate = verdict.comparison.candidate
    listed = d.outcome[..., None] == Outcome.AMBIGUOUS  # scores are stored for these only
    for name, values in {
        "outcome": d.outcome,
        "reason": d.reason,
        "object": d.object_id,
        "option": d.option_id,
        "blocked": d.option_blocked,
        "status": np.where(d.outcome > 0, d.status, 0),
        "status_final": np.where(d.outcome > 0, d.status_final, 0),
        "eligible": pairs.eligible,
        "anchors": verdict.anchors,
    }.items():
        np.testing.assert_array_equal(values, expected[name], name)
    for name, values in {
        "visual": np.where(candidate, verdict.comparison.score, 0),
        "known": np.where(candidate, pairs.score_known, 0),
        "score": d.score,
        "confidence": d.confidence,
        "option_score": np.where(listed, d.option_score, 0),
    }.items():
        # Options are stored to nine decimals.
        np.testing.assert_allclose(values, expected[name], atol=1e-9, rtol=0, err_msg=name)


def draw_frames(num: int) -> list[Frame]:
    """Frames without ties: look-alikes, clear ones and strangers, with and without context."""
    rng = np.random.default_rng(0)
    frames = []
    for _ in range(num):
        base, spread = rng.choice([0.65, 0.75, 0.85]), rng.choice([0.02, 0.1])
        scores = np.clip(base + spread * rng.standard_normal((NUM, SLOTS)), 0, 0.98)
        rows = [dict(enumerate(row[: rng.integers(2, SLOTS + 1)])) for row in scores]
        context = {o: backed(rng.uniform(0, 0.1)) for o in range(SLOTS) if rng.random() < 0.2}
        life = Lifecycle(int(rng.integers(0, 4)))
        age = int(rng.integers(0, 4))
        frames.append(visual_frame(rows, lifecycle=life, age=age, context=context, other=0.1))
    return frames


def test_order_of_detections_does_not_matter(x64):
    rng = np.random.default_rng(1)
    frames = draw_frames(BATCH)
    orders = [rng.permutation(NUM) for _ in frames]
    shuffled = [reorder(frame, order) for frame, order in zip(frames, orders, strict=True)]
    plain, other = decide_frames(frames).decisions, decide_frames(shuffled).decisions
    assert len(np.unique(plain.outcome)) > 4
    for name, before in vars(plain).items():
        after = getattr(other, name)
        if before.ndim > 1:
            before = np.stack([values[order] for values, order in zip(before, orders, strict=True)])
        # Sums over a component run in another order.
        np.testing.assert_allclose(after, before, atol=1e-12, err_msg=name)


def reorder(frame: Frame, order: np.ndarray) -> Frame:
    def rows(axis: int):
        return lambda leaf: np.take(leaf, order, axis)

    return dataclasses.replace(
        frame,
        class_id=frame.class_id[order],
        channels=jax.tree.map(rows(1), frame.channels),
        quality=jax.tree.map(rows(0), frame.quality),
        plausible=frame.plausible[order],
    )


def test_what_holds_for_every_frame(x64):
    verdict = decide_frames(draw_frames(2 * BATCH))
    d = verdict.decisions
    num_objects = np.max(np.where(verdict.comparison.candidate, np.arange(SLOTS), -1), axis=(1, 2))
    matched = d.outcome == MATCH
    assert (matched == (d.object_id >= 0)).all()
    assert (d.score[matched] >= 0.75).all()
    undecided = np.isin(d.outcome, [AMBIGUOUS, PARENT, PROVISIONAL])
    assert (undecided == (d.option_id[..., 0] >= 0)).all()
    assert (np.sum(d.option_id >= 0, axis=-1)[d.outcome == AMBIGUOUS] >= 2).all()
    assert (d.option_blocked <= (d.option_id >= 0)).all()
    for row in range(len(d.outcome)):
        ids = d.object_id[row][matched[row]]
        assert len(set(ids)) == len(ids)
        for options in d.option_id[row]:
            named = options[options >= 0]
            assert len(set(named)) == len(named)
            # Competitors of one birth name the object that it founds beside its parent.
            assert (named > num_objects[row]).sum() <= 1
