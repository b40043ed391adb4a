"""One id for each detection of a frame, where a tracker may say "one of these".

Rule: evaluation.md#paper-collapse. Letters: `N` detections, `C` candidates.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence

import numpy as np
from jaxtyping import Int
from scipy.optimize import linear_sum_assignment

from remind_jax.decision import NO_ID, Outcome
from remind_jax.metrics.decisions import FIRM, SOFT, Decisions

# A provisional new track has no object id yet; until then it is called this plus its pending id.
PROVISIONAL_BASE = 1_000_000_000

# The original gives births ids that none equals that of a known object, and never joins them again.
BORN_BASE = 2_000_000_000

_SURE = 1e12
_RANK_COST = 1e-6

Option = tuple[int, float]  # id, score


def collapse_frame(decisions: Decisions) -> Int[np.ndarray, "N"]:
    """Gives every detection of a frame at most one id.

    Firm detections keep theirs. All soft ones (ambiguous sets and probable parents) are settled in
    one assignment: as many as possible get one of their own candidates that is not taken by a firm
    detection, and among these solutions the total score is largest. Nobody ever gets an id outside
    of its candidate set. A provisional new track is `PROVISIONAL_BASE` plus its pending id.

    Returns:
      The id per detection, NO_ID without one. Ids of firm detections are not made unique.
    """
    outcome, object_id, pending_id = decisions.outcome, decisions.object_id, decisions.pending_id
    is_firm = np.isin(outcome, FIRM)
    label = np.where(is_firm, object_id, NO_ID).astype(np.int64)
    is_provisional = (outcome == Outcome.PROVISIONAL_NEW) & (pending_id != NO_ID)
    label[is_provisional] = PROVISIONAL_BASE + pending_id[is_provisional]
    soft = np.flatnonzero(np.isin(outcome, SOFT))
    options = [_list_candidates(decisions, row) for row in soft.tolist()]
    label[soft] = settle_candidates(options, {int(i) for i in object_id[is_firm]})
    return label


def collapse_published(decisions: Decisions) -> Int[np.ndarray, "N"]:
    """The id that the original scores each detection of a frame with.

    Ambiguous detections are settled jointly, all others keep their first option, conflicts
    included.

    Returns:
      An id of a known object, `BORN_BASE` plus the id of a created one, `PROVISIONAL_BASE` plus a
      provisional track, or NO_ID.
    """
    options = [_list_options(decisions, row) for row in range(len(decisions.outcome))]
    chosen = np.array([choices[0][0] if choices else NO_ID for choices in options], np.int64)
    soft = np.flatnonzero(decisions.outcome == Outcome.AMBIGUOUS)
    taken = {int(i) for i in np.delete(chosen, soft) if i != NO_ID}
    chosen[soft] = settle_candidates([options[row] for row in soft], taken)
    return chosen


def settle_candidates(
    options: Sequence[Sequence[Option]], taken: Collection[int]
) -> Int[np.ndarray, "N"]:
    """Gives undecided detections one of their own candidates each that is not taken; else NO_ID.

    All in one assignment: as many as possible get one; among these solutions the total score is
    largest.
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
    labels, column = np.unique(ids.astype(np.int64), return_inverse=True)
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


def _list_candidates(decisions: Decisions, row: int) -> list[Option]:
    ids, scores = decisions.candidate_id[row], decisions.candidate_score[row]
    known = (ids != NO_ID) & np.isfinite(scores)
    return list(zip(ids[known].tolist(), scores[known].tolist(), strict=True))


def _list_options(decisions: Decisions, row: int) -> list[Option]:
    """What the original lets a detection be, the best first."""
    outcome, object_id = decisions.outcome[row], int(decisions.object_id[row])
    if outcome == Outcome.MATCH:
        return [(object_id, _SURE)]
    if outcome == Outcome.NEW:
        return [(BORN_BASE + object_id, _SURE)]
    if outcome == Outcome.PROVISIONAL_NEW:
        return [(PROVISIONAL_BASE + int(decisions.pending_id[row]), _SURE)]
    if outcome not in SOFT:
        return []
    best: dict[int, float] = {}
    for number, score in _list_candidates(decisions, row):
        best[number] = max(score, best.get(number, -np.inf))
    ranked = sorted(best.items(), key=lambda option: (-option[1], option[0]))
    return [(number, score - _RANK_COST * rank) for rank, (number, score) in enumerate(ranked)]
