"""What must hold of every sequence."""

import dataclasses
from typing import Any

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from remind_jax.metrics.evaluation import evaluate_sequence, pool_evaluations
from remind_jax.metrics.sequence import TrackingSequence
from tests.metrics.tables import from_frames, random_sequence

SEEDS = st.integers(0, 2**31)

# Sums in another order: last bits of numbers near 1.
ROUNDING = 1e-12


def assert_scores(got: dict[str, Any], expected: dict[str, Any]) -> None:
    for name, value in expected.items():
        np.testing.assert_allclose(got[name], value, rtol=0, atol=ROUNDING, err_msg=name)


def per_frame(sequence: TrackingSequence) -> list[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    frames = []
    for t in range(sequence.num_frames):
        gt = slice(sequence.gt.start[t], sequence.gt.start[t + 1])
        pred = slice(sequence.pred.start[t], sequence.pred.start[t + 1])
        matrix = np.zeros((len(sequence.gt), len(sequence.pred)))
        matrix[sequence.pair_gt, sequence.pair_pred] = sequence.pair_similarity
        frames.append((sequence.gt.id[gt], sequence.pred.id[pred], matrix[gt, pred]))
    return frames


@settings(deadline=None, max_examples=25)
@given(SEEDS)
def test_new_names_change_nothing(seed: int):
    sequence = random_sequence(seed)
    rng = np.random.default_rng(seed + 1)
    gt_names, pred_names = rng.permutation(10**6)[:20], rng.permutation(10**6)[:20]
    renamed = dataclasses.replace(
        sequence,
        gt=dataclasses.replace(sequence.gt, id=gt_names[sequence.gt.id]),
        pred=dataclasses.replace(sequence.pred, id=pred_names[sequence.pred.id]),
    )
    assert_scores(evaluate_sequence(renamed).scores(), evaluate_sequence(sequence).scores())


@settings(deadline=None, max_examples=25)
@given(SEEDS)
def test_order_of_rows_changes_nothing(seed: int):
    sequence = random_sequence(seed)
    rng = np.random.default_rng(seed + 1)
    shuffled = []
    for gt, pred, matrix in per_frame(sequence):
        rows, columns = rng.permutation(len(gt)), rng.permutation(len(pred))
        shuffled.append((gt[rows], pred[columns], matrix[np.ix_(rows, columns)]))
    assert_scores(
        evaluate_sequence(from_frames(*zip(*shuffled, strict=True))).scores(),
        evaluate_sequence(sequence).scores(),
    )


@settings(deadline=None, max_examples=25)
@given(SEEDS, SEEDS)
def test_two_sequences_in_a_row_are_two_sequences_pooled(first_seed: int, second_seed: int):
    first, second = random_sequence(first_seed), random_sequence(second_seed)
    apart = [(gt + 100, pred + 100, matrix) for gt, pred, matrix in per_frame(second)]
    joined = from_frames(*zip(*[*per_frame(first), *apart], strict=True))
    pooled = pool_evaluations([evaluate_sequence(first), evaluate_sequence(second)])
    assert_scores(evaluate_sequence(joined).scores(), pooled.scores())


@settings(deadline=None, max_examples=25)
@given(SEEDS)
def test_truth_as_its_own_prediction_is_perfect(seed: int):
    frames = [(gt, gt, np.eye(len(gt))) for gt, _, _ in per_frame(random_sequence(seed))]
    scores = evaluate_sequence(from_frames(*zip(*frames, strict=True))).scores()
    for name in ("IDF1", "HOTA", "MOTA", "AssA"):
        assert scores[name] == 1.0
    assert scores["IDSW"] == 0
    if scores["Opportunities"]:
        assert scores["HardRecovery"] == 1.0
