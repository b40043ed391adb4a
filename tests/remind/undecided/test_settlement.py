"""Whole frames: frozen frames of the original's rules, and what holds for any frame."""

import dataclasses

import jax
import numpy as np

from remind_jax.decision import Outcome
from remind_jax.remind.memory.objects import Lifecycle
from tests.golden.load import load_expected
from tests.remind.association.frozen_frames import load_frames, load_thresholds
from tests.remind.association.tables import (
    BATCH,
    NUM,
    SLOTS,
    Frame,
    backed,
    decide_frames,
    visual_frame,
)

MATCH, NEW, AMBIGUOUS = Outcome.MATCH, Outcome.NEW, Outcome.AMBIGUOUS
PARENT, PROVISIONAL = Outcome.PROVISIONAL_PARENT, Outcome.PROVISIONAL_NEW


def test_frozen_frames(x64):
    """128 frames with every reason, half of them with thresholds of their own."""
    expected = load_expected("association/frames")
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
        channels=jax.tree.map(rows(2), frame.channels),
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
