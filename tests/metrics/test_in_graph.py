import functools
from typing import Any

import chex
import jax
import numpy as np
import pytest

from remind_jax.formats.firm import keep_unique
from remind_jax.metrics.evaluation import evaluate_sequence
from remind_jax.metrics.in_graph import NONE, GraphScores, score_labels
from remind_jax.metrics.sequence import TrackingSequence

FRAMES, SLOTS, OBJECTS, LABELS = 14, 6, 5, 9
FIELDS = {
    "idf1": "IDF1",
    "idp": "IDP",
    "idr": "IDR",
    "hota": "HOTA",
    "det_a": "DetA",
    "ass_a": "AssA",
    "recovery": "Recovery",
    "hard_recovery": "HardRecovery",
    "opportunities": "Opportunities",
}

# Single precision against double: sums of at most a few thousand ratios.
TOLERANCE = 1e-6


@jax.jit
@functools.partial(chex.assert_max_traces, n=1)
def _score_slots(*given):
    return score_labels(*given, num_objects=OBJECTS, num_labels=LABELS)


@pytest.fixture(autouse=True)
def _strict_ranks():
    with jax.numpy_rank_promotion("raise"):
        yield


def score_slots(gt: Any, ids: Any, firm: Any = None, score: Any = None) -> GraphScores:
    """With every argument given, so that one compilation serves all tests."""
    zeros = np.zeros(np.shape(gt), int)
    return _score_slots(
        gt,
        ids,
        ids if firm is None else firm,
        zeros.astype(float) if score is None else score,
    )


def assert_same(got: GraphScores, sequence: TrackingSequence) -> None:
    expected = evaluate_sequence(sequence).scores()
    for field, name in FIELDS.items():
        np.testing.assert_allclose(
            float(getattr(got, field)), expected[name], rtol=0, atol=TOLERANCE, err_msg=name
        )
    assert not bool(got.overflow)


def random_answers(seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """True objects, ids, scores and classes by slot; ids may cross classes and occur twice."""
    rng = np.random.default_rng(seed)
    gt, ids = np.full((FRAMES, SLOTS), NONE), np.full((FRAMES, SLOTS), NONE)
    for frame in range(FRAMES):
        objects = rng.permutation(OBJECTS)[: rng.integers(0, OBJECTS + 1)]
        slots = rng.permutation(SLOTS)[: len(objects)]
        gt[frame, slots] = objects
        answered = rng.random(len(objects)) < 0.8
        said = np.where(rng.random(len(objects)) < 0.6, objects, rng.integers(0, LABELS))
        ids[frame, slots] = np.where(answered, said, NONE)
        ids[frame, rng.integers(SLOTS)] = rng.integers(NONE, LABELS)
    score = rng.integers(0, 3, gt.shape) / 4  # with ties
    classes = np.where(gt == NONE, rng.integers(0, 2, gt.shape), gt % 2)
    return gt, ids, score, classes


def sequence_of(
    gt: np.ndarray, ids: np.ndarray, score: np.ndarray, classes: np.ndarray
) -> TrackingSequence:
    frame, slot = np.nonzero(gt != NONE)
    keep = np.array([keep_unique(i, s) for i, s in zip(ids, score, strict=True)])
    pred_frame, pred_slot = np.nonzero(keep)
    row = {pair: at for at, pair in enumerate(zip(pred_frame, pred_slot, strict=True))}
    pairs = [(at, row[p], 1.0) for at, p in enumerate(zip(frame, slot, strict=True)) if p in row]
    return TrackingSequence.create(
        FRAMES,
        (frame, gt[frame, slot]),
        (pred_frame, ids[pred_frame, pred_slot]),
        tuple(zip(*pairs, strict=True)) or ([], [], []),
        gt_class=classes[frame, slot],
        pred_class=classes[pred_frame, pred_slot],
        class_names=("a", "b"),
    )


@pytest.mark.parametrize("seed", range(20))
def test_labels_score_as_in_numpy(seed: int):
    gt, ids, score, classes = random_answers(seed)
    assert_same(score_slots(gt, ids, None, score), sequence_of(gt, ids, score, classes))


def test_settings_are_scored_side_by_side():
    gt, ids, _, _ = random_answers(0)
    settings = np.stack([ids, gt, np.full_like(ids, NONE)])
    scores = jax.vmap(lambda labels: score_slots(gt, labels))(settings)
    assert scores.idf1.shape == (3,)
    assert float(scores.idf1[1]) == 1.0
    assert float(scores.idf1[2]) == 0.0
    assert float(scores.idf1[0]) == float(score_slots(gt, ids).idf1)


def test_recovery_needs_firm_answers():
    gt, ids = np.full((2, FRAMES, SLOTS), NONE)
    visible = [0, 1, 4, 5, 8, 9]  # returns in frames 4 and 8
    gt[visible, 0], ids[visible, 0] = 0, [3, 3, 3, 3, 4, 3]
    soft = score_slots(gt, ids)
    assert (float(soft.recovery), float(soft.hard_recovery)) == (1.0, 0.5)
    firm = ids.copy()
    firm[9] = NONE
    assert float(score_slots(gt, ids, firm).recovery) == 0.5


def test_ids_beyond_the_labels_are_told():
    gt = np.zeros((FRAMES, SLOTS), int) + NONE
    gt[:, 0] = 0
    ids = np.where(gt == 0, LABELS + 3, NONE)
    scores = score_slots(gt, ids)
    assert bool(scores.overflow)
    assert float(scores.idf1) == 0.0
