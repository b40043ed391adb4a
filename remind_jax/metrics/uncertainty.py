"""Undecided answers: how many, and does the set hold the truth? Rule: evaluation.md#uncertainty.

Letters: `N` observations (a visible object in a frame), `C` candidates.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

from remind_jax.decision import NO_ID, Outcome
from remind_jax.metrics.combine import ratio
from remind_jax.metrics.decisions import FIRM, Decisions


@dataclasses.dataclass(frozen=True)
class UncertaintyCounts:
    """Observations by kind of answer; counts of several sequences add up."""

    observations: Float[np.ndarray, "*batch"]  # visible objects over all frames
    firm: Float[np.ndarray, "*batch"]  # MATCH, NEW
    firm_right: Float[np.ndarray, "*batch"]  # ... whose id is owned by the object
    ambiguous: Float[np.ndarray, "*batch"]  # AMBIGUOUS
    candidate_hits: Float[np.ndarray, "*batch"]  # ... with a candidate owned by the object


def count_uncertainty(
    frame: Int[np.ndarray, "N"], gt_id: Int[np.ndarray, "N"], decisions: Decisions
) -> UncertaintyCounts:
    """Judges firm answers and candidate sets by who owns the ids, see `find_owners`.

    Decisions are those on the detection of each observation, `Outcome.EMPTY` without one.
    """
    is_firm = np.isin(decisions.outcome, FIRM)
    is_ambiguous = decisions.outcome == Outcome.AMBIGUOUS
    firm_id = np.where(is_firm, decisions.object_id, NO_ID)
    owners = find_owners(frame, gt_id, firm_id)
    counts = (
        len(gt_id),
        is_firm.sum(),
        is_owned(firm_id, owners, gt_id).sum(),
        is_ambiguous.sum(),
        holds_truth(decisions.candidate_id[is_ambiguous], owners, gt_id[is_ambiguous]).sum(),
    )
    return UncertaintyCounts(*(np.asarray(int(count)) for count in counts))


def uncertainty_scores(counts: UncertaintyCounts) -> dict[str, Any]:
    """Shares of firm, ambiguous and weak answers, and how often they hold the truth.

    `WeakShare` is the rest: provisional, unassigned, dropped or not detected. NaN where undefined.
    """
    weak = counts.observations - counts.firm - counts.ambiguous
    return {
        "FirmShare": ratio(counts.firm, counts.observations),
        "FirmAccuracy": ratio(counts.firm_right, counts.firm),
        "AmbiguousShare": ratio(counts.ambiguous, counts.observations),
        "CandidateHitRate": ratio(counts.candidate_hits, counts.ambiguous),
        "WeakShare": ratio(weak, counts.observations),
    }


def find_owners(
    frame: Int[np.ndarray, "N"], gt_id: Int[np.ndarray, "N"], firm_id: Int[np.ndarray, "N"]
) -> dict[int, int]:
    """The object that each id was firmly given to most often; frames do not fall.

    Ties go to the object seen earlier, then to the smaller ground-truth id.
    """
    objects, first, index = np.unique(gt_id, return_index=True, return_inverse=True)
    first_seen = frame[first]
    said = firm_id != NO_ID
    pairs, count = np.unique(
        np.stack([firm_id[said], index[said]]).astype(np.int64), axis=1, return_counts=True
    )
    label, owner = pairs
    order = np.lexsort((owner, first_seen[owner], -count, label))
    found, best = np.unique(label[order], return_index=True)
    return dict(zip(found.tolist(), objects[owner[order][best]].tolist(), strict=True))


def is_owned(
    label: Int[np.ndarray, "N"], owners: Mapping[int, int], gt_id: Int[np.ndarray, "N"]
) -> Bool[np.ndarray, "N"]:
    """Whether each label is owned by the object beside it."""
    pairs = zip(label.tolist(), gt_id.tolist(), strict=True)
    return np.array([owners.get(number) == owner for number, owner in pairs], bool)


def holds_truth(
    candidates: Int[np.ndarray, "N C"], owners: Mapping[int, int], gt_id: Int[np.ndarray, "N"]
) -> Bool[np.ndarray, "N"]:
    """Whether each set has a candidate that is owned by the object beside it."""
    pairs = zip(candidates.tolist(), gt_id.tolist(), strict=True)
    return np.array([any(owners.get(n) == owner for n in row) for row, owner in pairs], bool)
