"""One-to-one matching of ground truth and predictions inside each frame."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.optimize import linear_sum_assignment

from remind_jax.metrics.sequence import TrackingSequence

EPSILON = float(np.finfo(np.float64).eps)

# Overlap at which a prediction is one of an object.
MATCH_THRESHOLD = 0.5

# Relative lead below which a pair counts as in doubt: far above rounding of the sums compared.
_DOUBT = 1e-9

# Marks solved cells; scores are positive.
_ASSIGNED = -1.0


def match_frames(
    sequence: TrackingSequence, score: Float[np.ndarray, "K"]
) -> Bool[np.ndarray, "K"]:
    """Chooses in every frame the one-to-one set of pairs with the largest total score.

    Most pairs are settled for the whole sequence at once; frames in which something is left in
    doubt are solved one by one. Pairs without a positive score are never chosen. Exact ties depend
    on the order of rows, as in TrackEval.
    """
    chosen, doubtful = _settle_sure_pairs(sequence, score)
    frames = np.unique(sequence.pair_frame[doubtful])
    starts = np.searchsorted(sequence.pair_frame, frames)
    stops = np.searchsorted(sequence.pair_frame, frames, side="right")
    for frame, start, stop in zip(frames, starts, stops, strict=True):
        pairs = np.arange(start, stop)[score[start:stop] > 0]
        chosen[pairs] = assign_frame(sequence, int(frame), pairs, score[pairs])
    return chosen


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
        is_admitted &= sequence.gt_class[gt] == sequence.pred_class[pred]
    chosen = match_frames(sequence, np.where(is_admitted, similarity, 0.0))
    return gt[chosen], pred[chosen], similarity[chosen]


def _settle_sure_pairs(
    sequence: TrackingSequence, score: Float[np.ndarray, "K"]
) -> tuple[Bool[np.ndarray, "K"], Int[np.ndarray, "D"]]:
    """Pairs that are part of every best matching, and those still in doubt.

    A pair worth more than all that compete with it for either row is sure: putting it in place of
    whatever excludes it (at most two pairs) always gains.
    """
    chosen = np.zeros(len(score), bool)
    left = np.flatnonzero(score > 0)
    while len(left):
        gt, pred, worth = sequence.pair_gt[left], sequence.pair_pred[left], score[left]
        gt_total, pred_total = np.bincount(gt, worth), np.bincount(pred, worth)
        rivals = gt_total[gt] + pred_total[pred] - 2 * worth
        sure = worth > rivals + _DOUBT * worth
        if not sure.any():
            break
        chosen[left[sure]] = True
        gt_taken = np.bincount(gt, sure) > 0
        pred_taken = np.bincount(pred, sure) > 0
        left = left[~gt_taken[gt] & ~pred_taken[pred]]
    return chosen, left


def has_rivals(sequence: TrackingSequence, pairs: Int[np.ndarray, "C"]) -> Bool[np.ndarray, "C"]:
    """Whether another of the given pairs shares a row with each; those without are a matching."""
    gt, pred = sequence.pair_gt[pairs], sequence.pair_pred[pairs]
    return (np.bincount(gt)[gt] > 1) | (np.bincount(pred)[pred] > 1)


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
    row = sequence.pair_gt[pairs] - sequence.gt_start[frame]
    column = sequence.pair_pred[pairs] - sequence.pred_start[frame]
    matrix = np.zeros((sequence.gt_counts[frame], sequence.pred_counts[frame]))
    matrix[row, column] = score
    rows, columns = linear_sum_assignment(matrix, maximize=True)
    matrix[rows, columns] = _ASSIGNED
    return matrix[row, column] == _ASSIGNED
