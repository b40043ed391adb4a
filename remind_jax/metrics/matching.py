"""One-to-one matching of ground truth and predictions inside each frame."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.optimize import linear_sum_assignment

from remind_jax.metrics.sequence import TrackingSequence

EPSILON = float(np.finfo(np.float64).eps)

# Overlap at which a prediction is one of an object.
MATCH_THRESHOLD = 0.5

# Marks solved cells; scores are positive.
_ASSIGNED = -1.0


def match_frames(
    sequence: TrackingSequence, score: Float[np.ndarray, "K"]
) -> Bool[np.ndarray, "K"]:
    """Chooses in every frame the one-to-one set of pairs with the largest total score.

    Pairs without a positive score are never chosen. Exact ties depend on the order of rows, as in
    TrackEval.
    """
    chosen = np.zeros(len(score), bool)
    for frame, pairs in split_frames(sequence, np.flatnonzero(score > 0)):
        chosen[pairs] = assign_frame(sequence, frame, pairs, score[pairs])
    return chosen


def split_frames(
    sequence: TrackingSequence, pairs: Int[np.ndarray, "C"]
) -> Iterator[tuple[int, Int[np.ndarray, "_"]]]:
    """Every frame that has some of these rising places in the table of pairs, and its own."""
    frames, starts = np.unique(sequence.pair_frame[pairs], return_index=True)
    yield from zip(frames.tolist(), np.split(pairs, starts[1:]), strict=False)


def match_detections(
    sequence: TrackingSequence,
    min_similarity: float = MATCH_THRESHOLD,
    *,
    within_class: bool = False,
) -> tuple[Int[np.ndarray, "M"], Int[np.ndarray, "M"], Float[np.ndarray, "M"]]:
    """One-to-one matches of largest total similarity: rows of truth, of predictions, similarity.

    Pairs below the least similarity, or on request of two classes, never match.
    """
    gt, pred, similarity = sequence.pair_gt, sequence.pair_pred, sequence.pair_similarity
    is_admitted = similarity >= min_similarity - EPSILON
    if within_class:
        is_admitted &= sequence.gt.class_index[gt] == sequence.pred.class_index[pred]
    chosen = match_frames(sequence, np.where(is_admitted, similarity, 0.0))
    return gt[chosen], pred[chosen], similarity[chosen]


def assign_frame(
    sequence: TrackingSequence,
    frame: int,
    pairs: Int[np.ndarray, "C"],
    score: Float[np.ndarray, "C"],
) -> Bool[np.ndarray, "C"]:
    """Solves one frame over all of its rows and says which of its pairs were chosen.

    Rows without any pair stay in the matrix, so that ties break as in a program that solves the
    full matrix.
    """
    row = sequence.pair_gt[pairs] - sequence.gt.start[frame]
    column = sequence.pair_pred[pairs] - sequence.pred.start[frame]
    matrix = np.zeros((sequence.gt.counts[frame], sequence.pred.counts[frame]))
    matrix[row, column] = score
    rows, columns = linear_sum_assignment(matrix, maximize=True)
    matrix[rows, columns] = _ASSIGNED
    return matrix[row, column] == _ASSIGNED
