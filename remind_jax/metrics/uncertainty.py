"""Undecided answers: how many there are, how good they are, and one id for each of them.

A tracker that may say "one of these" needs its sets judged (does the set hold the truth?) and,
where a metric wants one id per detection, a collapse of all soft decisions of a frame at once.
Rule: evaluation.md#uncertainty.

Letters: `N` detections, `C` candidates.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Collection, Sequence
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.optimize import linear_sum_assignment

from remind_jax.decision import NO_ID, Outcome
from remind_jax.metrics.sequence import number_ids

# A provisional new track has no object id yet; until then it is called this plus its pending id.
PROVISIONAL_BASE = 1_000_000_000

FIRM = (Outcome.MATCH, Outcome.NEW)
SOFT = (Outcome.AMBIGUOUS, Outcome.PROVISIONAL_PARENT)


@dataclasses.dataclass(frozen=True)
class UncertaintyCounts:
    """Observations by kind of answer; counts of several sequences add up."""

    observations: Float[np.ndarray, "*batch"]  # visible objects over all frames
    firm: Float[np.ndarray, "*batch"]  # MATCH, NEW
    firm_right: Float[np.ndarray, "*batch"]  # ... whose id is owned by the object
    ambiguous: Float[np.ndarray, "*batch"]  # AMBIGUOUS
    candidate_hits: Float[np.ndarray, "*batch"]  # ... with a candidate owned by the object


def collapse_frame(
    outcome: Int[np.ndarray, "N"],
    object_id: Int[np.ndarray, "N"],
    pending_id: Int[np.ndarray, "N"],
    candidate_id: Int[np.ndarray, "N C"],
    candidate_score: Float[np.ndarray, "N C"],
) -> Int[np.ndarray, "N"]:
    """Gives every detection of a frame at most one id.

    Firm detections keep theirs. All soft ones (ambiguous sets and probable parents) are settled in
    one assignment: as many as possible get one of their own candidates that is not taken by a firm
    detection, and among these solutions the total score is largest. Nobody ever gets an id outside
    of its candidate set. A provisional new track is `PROVISIONAL_BASE` plus its pending id.

    Returns:
      The id per detection, NO_ID without one. Ids of firm detections are not made unique.
    """
    is_firm = np.isin(outcome, FIRM)
    label = np.where(is_firm, object_id, NO_ID).astype(np.int64)
    is_provisional = (outcome == Outcome.PROVISIONAL_NEW) & (pending_id != NO_ID)
    label[is_provisional] = PROVISIONAL_BASE + pending_id[is_provisional]

    soft = np.flatnonzero(np.isin(outcome, SOFT))
    options = [
        [
            (int(number), float(score))
            for number, score in zip(candidate_id[row], candidate_score[row], strict=True)
            if number != NO_ID and np.isfinite(score)
        ]
        for row in soft
    ]
    label[soft] = settle_candidates(options, {int(i) for i in object_id[is_firm]})
    return label


def settle_candidates(
    options: Sequence[Sequence[tuple[int, float]]], taken: Collection[int]
) -> Int[np.ndarray, "N"]:
    """Gives undecided detections one of their own candidates each, in one assignment.

    As many as possible get one; among these solutions the total score is largest.

    Args:
      options: Candidates of each detection with their scores.
      taken: Ids that are not to be had.

    Returns:
      The id of each, NO_ID where nothing was left.
    """
    label = np.full(len(options), NO_ID, np.int64)
    pairs = [
        (row, number, score)
        for row, choices in enumerate(options)
        for number, score in choices
        if number not in taken
    ]
    if not pairs:
        return label
    row, ids, scores = (np.asarray(column) for column in zip(*pairs, strict=True))
    labels, column = number_ids(ids.astype(np.int64))
    # All gains in score together are less than 1, the worth of one more settled detection.
    spread = max(scores.max() - scores.min(), 1e-12)
    worth = 1.0 + (scores - scores.min()) / spread / (len(options) + 1)
    matrix = np.full((len(options), len(labels)), -np.inf)
    np.maximum.at(matrix, (row, column), worth)
    nobody = np.zeros((len(options), len(options)))
    rows, columns = linear_sum_assignment(np.hstack([matrix, nobody]), maximize=True)
    settled = columns < len(labels)
    label[rows[settled]] = labels[columns[settled]]
    return label


def keep_unique_labels(
    label: Int[np.ndarray, "N"], score: Float[np.ndarray, "N"]
) -> Bool[np.ndarray, "N"]:
    """Which detections keep their id where several of a frame claim the same one.

    The highest score wins, then the first detection; unlabelled detections are not kept.
    """
    order = np.lexsort((np.arange(len(label)), -np.asarray(score, float)))
    order = order[label[order] != NO_ID]
    _, first = np.unique(label[order], return_index=True)
    keep = np.zeros(len(label), bool)
    keep[order[first]] = True
    return keep


def count_uncertainty(
    frame: Int[np.ndarray, "N"],
    gt_id: Int[np.ndarray, "N"],
    outcome: Int[np.ndarray, "N"],
    object_id: Int[np.ndarray, "N"],
    candidate_id: Int[np.ndarray, "N C"],
) -> UncertaintyCounts:
    """Judges firm answers and candidate sets by who owns the ids.

    The owner of an id is the object that it was firmly given to most often; ties go to the object
    seen earlier, then to the smaller ground-truth id.

    Args:
      frame: Frame of each observation (visible object with its detection, if any).
      gt_id: Its object.
      outcome: What the tracker decided; `Outcome.EMPTY` without a detection.
      object_id: Firm id, else NO_ID.
      candidate_id: Ids shown for an undecided detection, NO_ID padding.
    """
    owner = find_owners(frame, gt_id, np.where(np.isin(outcome, FIRM), object_id, NO_ID))
    is_firm = np.isin(outcome, FIRM)
    firm_right = [
        owner.get(int(i)) == g for i, g in zip(object_id[is_firm], gt_id[is_firm], strict=True)
    ]
    is_ambiguous = outcome == Outcome.AMBIGUOUS
    hits = [
        any(owner.get(int(i)) == g for i in shown if i != NO_ID)
        for shown, g in zip(candidate_id[is_ambiguous], gt_id[is_ambiguous], strict=True)
    ]
    counts = (len(gt_id), is_firm.sum(), sum(firm_right), is_ambiguous.sum(), sum(hits))
    return UncertaintyCounts(*(np.asarray(int(count)) for count in counts))


def uncertainty_scores(counts: UncertaintyCounts) -> dict[str, Any]:
    """Shares of firm, ambiguous and weak answers, and how often they hold the truth.

    `WeakShare` is the rest: provisional, unassigned, dropped or not detected. NaN where undefined.
    """
    weak = counts.observations - counts.firm - counts.ambiguous
    return {
        "FirmShare": _share(counts.firm, counts.observations),
        "FirmAccuracy": _share(counts.firm_right, counts.firm),
        "AmbiguousShare": _share(counts.ambiguous, counts.observations),
        "CandidateHitRate": _share(counts.candidate_hits, counts.ambiguous),
        "WeakShare": _share(weak, counts.observations),
    }


def _share(part: Any, whole: Any) -> Float[np.ndarray, "*batch"]:
    return np.where(whole > 0, part / np.where(whole > 0, whole, 1), np.nan)


def find_owners(
    frame: Int[np.ndarray, "N"], gt_id: Int[np.ndarray, "N"], firm_id: Int[np.ndarray, "N"]
) -> dict[int, int]:
    """The object that each id was firmly given to most often.

    Ties go to the object seen earlier, then to the smaller ground-truth id.
    """
    objects, index = number_ids(gt_id.astype(np.int64))
    first_seen = np.full(len(objects), np.iinfo(np.int64).max)
    np.minimum.at(first_seen, index, frame)
    said = firm_id != NO_ID
    pairs, count = np.unique(
        np.stack([firm_id[said], index[said]]).astype(np.int64), axis=1, return_counts=True
    )
    label, owner = pairs
    order = np.lexsort((owner, first_seen[owner], -count, label))
    found, best = np.unique(label[order], return_index=True)
    return dict(zip(found.tolist(), objects[owner[order][best]].tolist(), strict=True))
