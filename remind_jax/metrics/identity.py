"""IDF1, IDP, IDR, as Ristani et al. 2016 (evaluation.md#identity-scores); equal to TrackEval's."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
from jaxtyping import Float, Int
from scipy.optimize import linear_sum_assignment

from remind_jax.metrics.matching import MATCH_THRESHOLD
from remind_jax.metrics.sequence import TrackingSequence


@dataclasses.dataclass(frozen=True)
class IdentityCounts:
    """Detections with right, missing and wrong identity; counts of several sequences add up."""

    true_positives: Float[np.ndarray, "*batch"]  # IDTP
    false_negatives: Float[np.ndarray, "*batch"]  # IDFN
    false_positives: Float[np.ndarray, "*batch"]  # IDFP


def count_right(sequence: TrackingSequence) -> Int[np.ndarray, "objects"]:
    """Frames in which each object carries its one right label.

    Maximizing these is the same as minimizing false positives plus false negatives.
    """
    right = np.zeros(len(sequence.gt.objects), np.int64)
    object_of, label_of, id_pair = sequence.id_pairs
    is_common = sequence.pair_similarity >= MATCH_THRESHOLD
    matrix = np.zeros((len(right), len(sequence.pred.objects)))
    matrix[object_of, label_of] = np.bincount(id_pair[is_common], minlength=len(object_of))
    rows, columns = linear_sum_assignment(matrix, maximize=True)
    right[rows] = matrix[rows, columns]
    return right


def identity_scores(counts: IdentityCounts) -> dict[str, Any]:
    """Identity fields under TrackEval's names, from the counts of one or of many sequences."""
    tp, fn, fp = counts.true_positives, counts.false_negatives, counts.false_positives
    return {
        "IDF1": tp / np.maximum(1.0, tp + 0.5 * fp + 0.5 * fn),
        "IDR": tp / np.maximum(1.0, tp + fn),
        "IDP": tp / np.maximum(1.0, tp + fp),
        "IDTP": tp,
        "IDFN": fn,
        "IDFP": fp,
    }
