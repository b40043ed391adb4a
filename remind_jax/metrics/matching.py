"""One-to-one matching of ground truth and predictions inside each frame."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.optimize import linear_sum_assignment

from remind_jax.metrics.sequence import TrackingSequence

EPSILON = float(np.finfo(np.float64).eps)


def match_frames(
    sequence: TrackingSequence, score: Float[np.ndarray, "K"]
) -> Bool[np.ndarray, "K"]:
    """Chooses in every frame the one-to-one set of pairs with the largest total score.

    Args:
      sequence: Where the pairs come from.
      score: Worth of each pair; pairs without a positive score are never chosen.

    Returns:
      Whether each pair was chosen. Exact ties depend on the order of rows, as in TrackEval.
    """
    chosen = score > 0
    candidates = np.flatnonzero(chosen)
    contested = contested_frames(sequence, candidates)
    frame = sequence.pair_frame[candidates]
    start = np.searchsorted(frame, contested)
    stop = np.searchsorted(frame, contested, side="right")
    for t, first, last in zip(contested, start, stop, strict=True):
        pairs = candidates[first:last]
        chosen[pairs] = assign_frame(sequence, int(t), pairs, score[pairs])
    return chosen


def contested_frames(
    sequence: TrackingSequence, pairs: Int[np.ndarray, "C"]
) -> Int[np.ndarray, "frames"]:
    """Frames in which a row takes part in more than one of the given pairs, ascending.

    Elsewhere the pairs are a matching already and nothing has to be solved.
    """
    gt, pred = sequence.pair_gt[pairs], sequence.pair_pred[pairs]
    gt_degree = np.bincount(gt, minlength=len(sequence.gt_id))
    pred_degree = np.bincount(pred, minlength=len(sequence.pred_id))
    contested = (gt_degree[gt] > 1) | (pred_degree[pred] > 1)
    is_contested = np.zeros(sequence.num_frames, bool)
    is_contested[sequence.pair_frame[pairs[contested]]] = True
    return np.flatnonzero(is_contested)


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
    first_gt, first_pred = sequence.gt_start[frame], sequence.pred_start[frame]
    num_gt = sequence.gt_start[frame + 1] - first_gt
    num_pred = sequence.pred_start[frame + 1] - first_pred
    row = sequence.pair_gt[pairs] - first_gt
    column = sequence.pair_pred[pairs] - first_pred
    matrix = np.zeros((num_gt, num_pred))
    matrix[row, column] = score
    assigned = np.full(num_gt, -1)
    rows, columns = linear_sum_assignment(matrix, maximize=True)
    assigned[rows] = columns
    return assigned[row] == column
