"""How sure a score is: bootstrap intervals over scenes, or over the objects of a single scene.

Over objects, what belongs to an object (its matches, misses, switches, wrongly named detections) is
drawn with it; false positives on no object are the same in every draw.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from remind_jax.metrics.clear import (
    MOSTLY_LOST,
    MOSTLY_TRACKED,
    ClearCounts,
    clear_scores,
    find_breaks,
    match_clear,
)
from remind_jax.metrics.combine import (
    bootstrap_intervals,
    stack_counts,
    sum_counts,
)
from remind_jax.metrics.hota import ALPHAS, HotaCounts, hota_scores, match_hota
from remind_jax.metrics.identity import (
    IDENTITY_THRESHOLD,
    IdentityCounts,
    count_right,
    identity_scores,
)
from remind_jax.metrics.matching import EPSILON
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
    """The counts of one sequence by true object; units and remainder add up to the whole.

    Args:
      sequence: Truth and predictions.
      recovery: Of its objects, ascending.
    """
    hota, hota_rest, num_claimed = _split_hota(sequence)
    clear, clear_rest = _split_clear(sequence)
    right = count_right(sequence)
    identity = IdentityCounts(right, sequence.gt_lengths - right, num_claimed - right)
    unclaimed = len(sequence.pred_id) - int(num_claimed.sum())
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
    """Counts with an axis over scenes.

    Args:
      families: Per scene its counts: HOTA, CLEAR, identity, recovery (summed), ...
    """
    stacked = tuple(stack_counts(column) for column in zip(*families, strict=True))
    nothing = tuple(_zeros_like(counts) for counts in stacked)
    return UnitCounts(stacked, nothing, "scene")


def _zeros_like(counts: Any) -> Any:
    total = sum_counts(counts)
    zeros = {f.name: np.zeros_like(getattr(total, f.name)) for f in dataclasses.fields(total)}
    return type(total)(**zeros)


def _split_hota(sequence: TrackingSequence) -> tuple[HotaCounts, HotaCounts, np.ndarray]:
    """By object; the rest; and how many predictions overlap each object by a half or more."""
    num = len(sequence.gt_objects)
    chosen = np.flatnonzero(match_hota(sequence))
    object_of, label_of, id_pair = sequence.id_pairs
    id_pair, similarity = id_pair[chosen], sequence.pair_similarity[chosen]
    owner = sequence.gt_index[sequence.pair_gt[chosen]]
    claimed = np.bincount(owner, minlength=num)
    gt_lengths, pred_lengths = sequence.gt_lengths[object_of], sequence.pred_lengths[label_of]
    fields = np.zeros((7, num, len(ALPHAS)))
    for at, alpha in enumerate(ALPHAS):
        is_match = similarity >= alpha - EPSILON
        matches = np.bincount(id_pair[is_match], minlength=len(object_of))
        unions = (gt_lengths + pred_lengths - matches, gt_lengths, pred_lengths)
        shares = (matches * (matches / np.maximum(1, union)) for union in unions)
        found = np.bincount(owner[is_match], minlength=num)
        fields[:, :, at] = (
            found,
            sequence.gt_lengths - found,
            claimed - found,
            np.bincount(owner[is_match], similarity[is_match], num),
            *(np.bincount(object_of, share, num) for share in shares),
        )
    rest = np.zeros((7, len(ALPHAS)))
    rest[2] = len(sequence.pred_id) - claimed.sum()
    close = similarity >= IDENTITY_THRESHOLD
    return HotaCounts(*fields), HotaCounts(*rest), np.bincount(owner[close], minlength=num)


def _split_clear(sequence: TrackingSequence) -> tuple[ClearCounts, ClearCounts]:
    lengths = sequence.gt_lengths
    num = len(lengths)
    matches = match_clear(sequence)
    owner = sequence.gt_index[sequence.pair_gt[matches]]
    is_switch, is_break, of_break = find_breaks(sequence, matches)
    found = np.bincount(owner, minlength=num)
    tracked = found / np.maximum(1, lengths)
    is_mt, is_ml = tracked > MOSTLY_TRACKED, tracked < MOSTLY_LOST
    nothing = np.zeros(num)
    counts = ClearCounts(
        found,
        lengths - found,
        nothing,
        np.bincount(of_break[is_switch], minlength=num),
        np.bincount(of_break[is_break], minlength=num),
        is_mt.astype(int),
        (~is_mt & ~is_ml).astype(int),
        is_ml.astype(int),
        np.bincount(owner, sequence.pair_similarity[matches], num),
        nothing,
    )
    zero = np.zeros(())
    rest = ClearCounts(*([zero] * 10))
    rest = dataclasses.replace(
        rest,
        false_positives=np.asarray(float(len(sequence.pred_id) - len(matches))),
        frames=np.asarray(float(sequence.num_frames)),
    )
    return counts, rest
