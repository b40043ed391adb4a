"""How sure a score is: bootstrap intervals over scenes, or over the objects of a single scene."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from remind_jax.metrics.clear import ClearCounts, clear_scores, split_clear
from remind_jax.metrics.combine import bootstrap_intervals
from remind_jax.metrics.hota import HotaCounts, hota_scores, match_hota, split_hota
from remind_jax.metrics.identity import IdentityCounts, count_right, identity_scores
from remind_jax.metrics.matching import MATCH_THRESHOLD
from remind_jax.metrics.recovery import RecoveryCounts, recovery_scores
from remind_jax.metrics.sequence import TrackingSequence
from remind_jax.metrics.uncertainty import UncertaintyCounts, uncertainty_scores

Intervals = dict[str, tuple[float, float]]

_SCORES: dict[type, Callable[[Any], Any]] = {
    HotaCounts: hota_scores,
    ClearCounts: lambda counts: clear_scores(counts, pooled=True),
    IdentityCounts: identity_scores,
    RecoveryCounts: recovery_scores,
    UncertaintyCounts: uncertainty_scores,
}

# Counts with a leading axis over units, and those that belong to no unit, if there are any.
Family = tuple[Any, Any]


def bootstrap_families(families: Sequence[Family], **options: Any) -> Intervals:
    """Intervals of the scores of all kinds of counts; none with fewer than two units.

    Options are those of `combine.bootstrap_intervals`.
    """
    if len(families[0][0].true_positives) < 2:
        return {}
    found: Intervals = {}
    for counts, rest in families:
        score = _SCORES[type(counts)]
        found |= bootstrap_intervals(counts, score, remainder=rest, **options)
    return found


def split_by_object(sequence: TrackingSequence, recovery: RecoveryCounts) -> list[Family]:
    """The counts of one sequence by true object: HOTA, CLEAR, identity, recovery."""
    chosen = match_hota(sequence)
    hota, hota_rest = split_hota(sequence, chosen)
    clear, clear_rest = split_clear(sequence)
    is_close = chosen & (sequence.pair_similarity >= MATCH_THRESHOLD)
    owner = sequence.gt_index[sequence.pair_gt[is_close]]
    num_claimed = np.bincount(owner, minlength=len(sequence.gt_objects))
    right = count_right(sequence)
    identity = IdentityCounts(right, sequence.gt_lengths - right, num_claimed - right)
    unclaimed = np.asarray(len(sequence.pred_id) - num_claimed.sum())
    nothing = np.zeros((), np.int64)
    return [
        (hota, hota_rest),
        (clear, clear_rest),
        (identity, IdentityCounts(nothing, nothing, unclaimed)),
        (recovery, None),
    ]
