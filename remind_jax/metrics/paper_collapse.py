"""One id for every detection, as the original evaluator chooses it before it counts.

Rule: evaluation.md#paper-collapse. One deviation: an ambiguous detection whose candidates are all
taken stays without an id; the original's solver may then hand it any free id, out of its set.

Letters: `N` detections of a frame, `C` candidates.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import numpy as np
from jaxtyping import Float, Int

from remind_jax.decision import NO_ID, Outcome
from remind_jax.metrics.uncertainty import settle_candidates

Collapse = Literal["hungarian", "greedy"]

# Ids of births, so that none equals that of a known object: the original never joins them again.
BORN_BASE = 2_000_000_000
PROVISIONAL_BASE = 1_000_000_000

_SURE = 1e12
_RANK_COST = 1e-6

Option = tuple[int, float]  # id, score


def collapse_published(
    outcome: Int[np.ndarray, "N"],
    object_id: Int[np.ndarray, "N"],
    pending_id: Int[np.ndarray, "N"],
    candidate_id: Int[np.ndarray, "N C"],
    candidate_score: Float[np.ndarray, "N C"],
    iou: Float[np.ndarray, "N"],
    method: Collapse = "hungarian",
) -> Int[np.ndarray, "N"]:
    """The id that each detection of a frame is scored with.

    Args:
      outcome: Decision codes.
      object_id: Firm id, else NO_ID.
      pending_id: Provisional track, else NO_ID.
      candidate_id: Candidates of undecided detections, NO_ID padding.
      candidate_score: Their scores.
      iou: Overlap of each detection with its object, -1 without one.
      method: `hungarian` settles ambiguous detections jointly and leaves all others their first
        option, conflicts included; `greedy` lets the losers of a conflict move on.

    Returns:
      An id of a known object, `BORN_BASE` plus the id of a created one, `PROVISIONAL_BASE` plus a
      provisional track, or NO_ID.
    """
    options = [
        _list_options(*row)
        for row in zip(outcome, object_id, pending_id, candidate_id, candidate_score, strict=True)
    ]
    if method == "greedy":
        return _resolve_conflicts(options, iou)
    chosen = np.array([choices[0][0] if choices else NO_ID for choices in options], np.int64)
    soft = np.flatnonzero(outcome == Outcome.AMBIGUOUS)
    taken = {int(i) for i in np.delete(chosen, soft) if i != NO_ID}
    chosen[soft] = settle_candidates([options[row] for row in soft], taken)
    return chosen


def _list_options(
    outcome: int, object_id: int, pending_id: int, candidates: np.ndarray, scores: np.ndarray
) -> list[Option]:
    if outcome == Outcome.MATCH:
        return [(int(object_id), _SURE)]
    if outcome == Outcome.NEW:
        return [(BORN_BASE + int(object_id), _SURE)]
    if outcome == Outcome.PROVISIONAL_NEW:
        return [(PROVISIONAL_BASE + int(pending_id), _SURE)]
    if outcome not in (Outcome.AMBIGUOUS, Outcome.PROVISIONAL_PARENT):
        return []
    best: dict[int, float] = {}
    for number, score in zip(candidates.tolist(), scores.tolist(), strict=True):
        if number != NO_ID and np.isfinite(score):
            best[number] = max(score, best.get(number, -np.inf))
    ranked = sorted(best.items(), key=lambda option: (-option[1], option[0]))
    return [(number, score - _RANK_COST * rank) for rank, (number, score) in enumerate(ranked)]


def _resolve_conflicts(
    options: Sequence[Sequence[Option]], iou: Float[np.ndarray, "N"]
) -> Int[np.ndarray, "N"]:
    """All start at their first option; of those at one id the strongest stays, others move on."""
    place = [0] * len(options)

    def id_at(row: int) -> int:
        return options[row][place[row]][0] if place[row] < len(options[row]) else NO_ID

    def strength(row: int) -> tuple[float, float, int]:
        return options[row][place[row]][1], float(iou[row]), -row

    moved = True
    while moved:
        moved = False
        claims: dict[int, list[int]] = {}
        for row in range(len(options)):
            if id_at(row) != NO_ID:
                claims.setdefault(id_at(row), []).append(row)
        for disputed, rows in claims.items():
            winner = max(rows, key=strength)
            for row in rows:
                while row != winner and id_at(row) == disputed:
                    place[row] += 1
                    moved = True
    return np.array([id_at(row) for row in range(len(options))], np.int64)
