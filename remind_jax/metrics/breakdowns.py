"""IDF1 by circumstances, whose reference is that of the whole scene (evaluation.md#breakdowns).

Letters: `N` observations (a visible object in a frame), `B` bins.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Float, Int, Num

from remind_jax.metrics.recovery import NO_LABEL, Answers, collect_answers, find_reference
from remind_jax.metrics.sequence import TrackingSequence

# Left-closed bins, as "< 0.1 %" and ">= 10 %" of the paper's figures ask for.
DISTRACTOR_BINS = {"0": 0, "1": 1, "2": 2, "3-4": 3, "5-8": 5, "9-16": 9, "17+": 17}
SIZE_BINS = {"tiny": 0.0, "small": 0.001, "medium": 0.005, "large": 0.02, "huge": 0.1}
VISIBLE_BINS = {"0-5": 0, "5-10": 5, "10-20": 10, "20-40": 20, "40+": 40}


@dataclasses.dataclass(frozen=True)
class Breakdown:
    """Observations by bin; those of several sequences add up by the names of the bins."""

    bins: tuple[str, ...]
    observations: Int[np.ndarray, "B"]
    answered: Int[np.ndarray, "B"]  # with an id
    right: Int[np.ndarray, "B"]  # with the object's id

    @property
    def idf1(self) -> Float[np.ndarray, "B"]:
        """Twice the right answers over answers plus observations; NaN in an empty bin."""
        total = self.observations + self.answered
        return np.where(total > 0, 2 * self.right / np.maximum(1, total), np.nan)


def count_breakdowns(
    sequence: TrackingSequence,
    *,
    area_share: Float[np.ndarray, "N"] | None = None,
    gt_class: Int[np.ndarray, "N"] | None = None,
    class_names: Sequence[str] = (),
) -> dict[str, Breakdown]:
    """Breakdowns of one sequence: `visible`, and what else is known of the truth.

    The share of its frame that each observation covers gives `size`, the class of each gives
    `distractors` and `class`.
    """
    answers = collect_answers(sequence)
    frame = sequence.gt_frame
    visible = np.bincount(frame, minlength=sequence.num_frames)[frame]
    breakdowns = {"visible": _count_bins(answers, VISIBLE_BINS, visible)}
    if area_share is not None:
        breakdowns["size"] = _count_bins(answers, SIZE_BINS, area_share)
    if gt_class is not None:
        key = frame * max(1, len(class_names)) + gt_class
        same_class = np.bincount(key)[key] - 1 if len(key) else key
        breakdowns["distractors"] = _count_bins(answers, DISTRACTOR_BINS, same_class)
        breakdowns["class"] = _count(answers, tuple(class_names), gt_class)
    return breakdowns


def pool_breakdowns(parts: Sequence[Mapping[str, Breakdown]]) -> dict[str, Breakdown]:
    """Adds breakdowns of several sequences; bins keep the order in which they first occur."""
    pooled = {}
    for name in dict.fromkeys(name for part in parts for name in part):
        found = [part[name] for part in parts if name in part]
        bins = tuple(dict.fromkeys(label for b in found for label in b.bins))
        sums = np.zeros((3, len(bins)), np.int64)
        for breakdown in found:
            at = [bins.index(label) for label in breakdown.bins]
            sums[:, at] += [breakdown.observations, breakdown.answered, breakdown.right]
        pooled[name] = Breakdown(bins, *sums)
    return pooled


def _count_bins(
    answers: Answers, bins: Mapping[str, float], value: Num[np.ndarray, "N"]
) -> Breakdown:
    edges = np.array(list(bins.values()))
    return _count(answers, tuple(bins), np.searchsorted(edges, value, side="right") - 1)


def _count(answers: Answers, bins: tuple[str, ...], place: Int[np.ndarray, "N"]) -> Breakdown:
    reference = find_reference(answers)
    index = np.searchsorted(answers.objects, answers.gt_id)
    is_answered = answers.label != NO_LABEL
    is_right = is_answered & (answers.label == reference[index]) if len(index) else is_answered
    counts = (
        np.bincount(place[chosen], minlength=len(bins))
        for chosen in (np.ones(len(place), bool), is_answered, is_right)
    )
    return Breakdown(bins, *counts)
