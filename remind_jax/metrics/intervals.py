"""How sure a score is: bootstrap intervals over scenes, or over the objects of a single scene.

Over objects, what belongs to an object (its matches, misses, switches, wrongly named detections) is
drawn with it; false positives on no object are the same in every draw.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from remind_jax.metrics.clear import ClearCounts, clear_scores, split_clear
from remind_jax.metrics.combine import bootstrap_intervals, map_counts, stack_counts, sum_counts
from remind_jax.metrics.hota import HotaCounts, hota_scores, match_hota, split_hota
from remind_jax.metrics.identity import (
    IDENTITY_THRESHOLD,
    IdentityCounts,
    count_right,
    identity_scores,
)
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


@dataclasses.dataclass(frozen=True)
class UnitCounts:
    """Counts by unit (a leading axis), and what belongs to none."""

    families: tuple[Any, ...]  # HotaCounts, ClearCounts, ... with an axis over units
    remainders: tuple[Any, ...]  # the same without it
    unit: str  # "scene" or "object"

    @property
    def num_units(self) -> int:
        """How many there are to draw from."""
        return len(self.families[0].true_positives)

    def intervals(
        self, *, level: float = 0.95, num_resamples: int = 1000, seed: int = 0
    ) -> Intervals:
        """Percentile bootstrap intervals by name of the score; none with fewer than two units."""
        if self.num_units < 2:
            return {}
        found: Intervals = {}
        for counts, remainder in zip(self.families, self.remainders, strict=True):
            found |= bootstrap_intervals(
                counts,
                _SCORES[type(counts)],
                remainder=remainder,
                level=level,
                num_resamples=num_resamples,
                seed=seed,
            )
        return found


def split_by_object(sequence: TrackingSequence, recovery: RecoveryCounts) -> UnitCounts:
    """The counts of one sequence by true object; units and remainder add up to the whole."""
    chosen = match_hota(sequence)
    hota, hota_rest = split_hota(sequence, chosen)
    clear, clear_rest = split_clear(sequence)
    is_close = chosen & (sequence.pair_similarity >= IDENTITY_THRESHOLD)
    owner = sequence.gt_index[sequence.pair_gt[is_close]]
    num_claimed = np.bincount(owner, minlength=len(sequence.gt_objects))
    right = count_right(sequence)
    identity = IdentityCounts(right, sequence.gt_lengths - right, num_claimed - right)
    unclaimed = len(sequence.pred_id) - num_claimed.sum()
    nothing = np.zeros((), np.int64)
    return UnitCounts(
        (hota, clear, identity, recovery),
        (
            hota_rest,
            clear_rest,
            IdentityCounts(nothing, nothing, np.asarray(unclaimed)),
            RecoveryCounts(nothing, nothing, nothing),
        ),
        "object",
    )


def split_by_scene(families: Sequence[tuple[Any, ...]]) -> UnitCounts:
    """Counts with an axis over scenes, from the counts of each: HOTA, CLEAR, identity, ..."""
    stacked = tuple(stack_counts(column) for column in zip(*families, strict=True))
    nothing = tuple(map_counts(np.zeros_like, sum_counts(counts)) for counts in stacked)
    return UnitCounts(stacked, nothing, "scene")
