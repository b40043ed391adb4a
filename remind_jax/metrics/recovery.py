"""Recovery: does an object get its identity back when it returns? evaluation.md#recovery."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
from jaxtyping import Float, Int
from scipy.optimize import linear_sum_assignment

from remind_jax.metrics.combine import ratio
from remind_jax.metrics.matching import match_detections
from remind_jax.metrics.sequence import TrackingSequence

NO_LABEL = -1
ANY_CLASS = -1

# In the reference common frames come first, overlap breaks ties.
_FRAME_WEIGHT = 1000.0


@dataclasses.dataclass(frozen=True)
class Answers:
    """What a tracker firmly said about each visible object.

    Letters: `N` observations (a visible object in a frame), `L` labels.
    """

    frame: Int[np.ndarray, "N"]  # processed frame
    gt_id: Int[np.ndarray, "N"]
    label: Int[np.ndarray, "N"]  # 0 ... L - 1, NO_LABEL without a firm answer
    similarity: Float[np.ndarray, "N"]  # of the answering detection, 0 without one
    gt_class: Int[np.ndarray, "N"]
    label_class: Int[np.ndarray, "L"]  # ANY_CLASS where unknown

    @property
    def objects(self) -> Int[np.ndarray, "objects"]:
        """Ids of the objects, ascending; references and counts per object are in this order."""
        return np.unique(self.gt_id)


@dataclasses.dataclass(frozen=True)
class RecoveryCounts:
    """Returns of objects; counts of several objects or sequences add up."""

    opportunities: Float[np.ndarray, "*batch"]
    recovered: Float[np.ndarray, "*batch"]
    hard_recovered: Float[np.ndarray, "*batch"]


def collect_answers(sequence: TrackingSequence) -> Answers:
    """Matches predictions with ground truth and keeps what each visible object was called.

    Within a frame the total similarity is maximized. Labels are positions in
    `sequence.pred.objects`. Classes do not count: a detector may name one thing now so, now so.
    """
    gt, pred, similarity = match_detections(sequence)
    label = np.full(len(sequence.gt), NO_LABEL)
    label[gt] = sequence.pred.index[pred]
    overlap = np.zeros(len(sequence.gt))
    overlap[gt] = similarity
    any_class = np.full(len(sequence.gt), ANY_CLASS), np.full(len(sequence.pred.objects), ANY_CLASS)
    return Answers(sequence.gt.frame, sequence.gt.id, label, overlap, *any_class)


def find_reference(answers: Answers) -> Int[np.ndarray, "objects"]:
    """The label that counts as right for each object, NO_LABEL if there is none.

    Each label is assigned to at most one object, by common frames, then overlap, per class where
    answers have classes, as in the paper's protocol (the original's evaluator; a tracker gains
    nothing by calling everything alike).
    """
    objects, index = np.unique(answers.gt_id, return_inverse=True)
    said = np.flatnonzero(answers.label != NO_LABEL)
    num_labels = max(1, len(answers.label_class))
    found, member = np.unique(index[said] * num_labels + answers.label[said], return_inverse=True)
    owner, label = found // num_labels, found % num_labels
    count = np.bincount(member, minlength=len(found))
    overlap = np.bincount(member, answers.similarity[said], len(found))
    object_class = np.zeros(len(objects), np.int64)
    object_class[index[::-1]] = answers.gt_class[::-1]
    weight = _FRAME_WEIGHT * count + overlap
    reference = np.full(len(objects), NO_LABEL)
    for class_id in np.unique(object_class):
        fits = np.isin(answers.label_class[label], [class_id, ANY_CLASS])
        here = fits & (object_class[owner] == class_id)
        if not here.any():
            continue
        rows, row = np.unique(owner[here], return_inverse=True)
        columns, column = np.unique(label[here], return_inverse=True)
        matrix = np.zeros((len(rows), len(columns)))
        matrix[row, column] = weight[here]
        chosen_row, chosen_column = linear_sum_assignment(matrix, maximize=True)
        is_common = matrix[chosen_row, chosen_column] > 0
        reference[rows[chosen_row[is_common]]] = columns[chosen_column[is_common]]
    return reference


def count_recovery(
    answers: Answers, reference: Int[np.ndarray, "objects"], min_absence_frames: int = 1
) -> RecoveryCounts:
    """Counts the returns of every object, in the order of `answers.objects`, and the recovered.

    Args:
      min_absence_frames: After shorter gaps an object does not return, it was there.
    """
    objects, index = np.unique(answers.gt_id, return_inverse=True)
    order = np.lexsort((answers.frame, index))
    index, frame = index[order], answers.frame[order]
    is_right = (answers.label[order] == reference[index]) & (answers.label[order] != NO_LABEL)
    is_first_sight = np.diff(index, prepend=-1) != 0
    is_return = ~is_first_sight & (np.diff(frame, prepend=0) > min_absence_frames)
    interval = np.cumsum(is_first_sight | is_return) - 1
    starts = np.flatnonzero(is_first_sight | is_return)
    has_right = np.bincount(interval, is_right, len(starts)) > 0
    counted = is_return[starts]
    owner = index[starts][counted]

    def per_object(holds: np.ndarray) -> np.ndarray:
        return np.bincount(owner[holds[counted]], minlength=len(objects))

    return RecoveryCounts(
        per_object(np.ones(len(starts), bool)), per_object(has_right), per_object(is_right[starts])
    )


def recovery_scores(counts: RecoveryCounts) -> dict[str, Any]:
    """Recovery rates and what they were counted from; NaN where nothing ever returned."""
    return {
        "Recovery": ratio(counts.recovered, counts.opportunities),
        "HardRecovery": ratio(counts.hard_recovered, counts.opportunities),
        "Opportunities": counts.opportunities,
        "Recovered": counts.recovered,
        "HardRecovered": counts.hard_recovered,
    }
