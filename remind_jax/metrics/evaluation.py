"""All counts of a sequence, of several pooled, and the scores that follow from them.

Recovery is counted from firm answers alone (evaluation.md#recovery).
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from jaxtyping import Int

from remind_jax.metrics import combine
from remind_jax.metrics.clear import ClearCounts, clear_scores, split_clear
from remind_jax.metrics.hota import HotaCounts, hota_scores, match_hota, split_hota
from remind_jax.metrics.identity import IdentityCounts, count_right, identity_scores
from remind_jax.metrics.matching import MATCH_THRESHOLD
from remind_jax.metrics.recovery import (
    RecoveryCounts,
    collect_answers,
    count_recovery,
    find_reference,
    recovery_scores,
)
from remind_jax.metrics.sequence import TrackingSequence
from remind_jax.metrics.uncertainty import UncertaintyCounts, uncertainty_scores
from remind_jax.printing.small_table import Printable, SmallTable

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
        found |= combine.bootstrap_intervals(counts, score, remainder=rest, **options)
    return found


def split_by_object(sequence: TrackingSequence) -> list[Family]:
    """The counts of one sequence by true object: HOTA, CLEAR, identity."""
    chosen = match_hota(sequence)
    is_close = chosen & (sequence.pair_similarity >= MATCH_THRESHOLD)
    owner = sequence.gt.index[sequence.pair_gt[is_close]]
    num_claimed = np.bincount(owner, minlength=len(sequence.gt.objects))
    right = count_right(sequence)
    identity = IdentityCounts(right, sequence.gt.lengths - right, num_claimed - right)
    unclaimed = np.asarray(len(sequence.pred) - num_claimed.sum())
    nothing = np.zeros((), np.int64)
    return [
        split_hota(sequence, chosen),
        split_clear(sequence),
        (identity, IdentityCounts(nothing, nothing, unclaimed)),
    ]


@dataclasses.dataclass(frozen=True)
class SizeCounts:
    """How much was evaluated; counts of several sequences add up."""

    predicted_rows: Int[np.ndarray, "*batch"]
    gt_rows: Int[np.ndarray, "*batch"]
    predicted_ids: Int[np.ndarray, "*batch"]  # identities found
    gt_ids: Int[np.ndarray, "*batch"]  # true objects
    frames: Int[np.ndarray, "*batch"]
    repeated_ids: Int[np.ndarray, "*batch"]  # ids taken back, given twice in one frame


# Scores and counts that are shown side by side.
MAIN_SCORES = (
    "HOTA", "DetA", "AssA", "LocA", "MOTA", "IDF1", "IDP", "IDR", "Recovery", "HardRecovery"
)  # fmt: skip
MAIN_COUNTS = ("IDSW", "Frag", "MT", "PT", "ML", "GT_IDs", "IDs", "GT_Dets", "Dets", "Frames")


@dataclasses.dataclass(frozen=True, repr=False)
class Evaluation(Printable):
    """All counts of one sequence, or of several pooled, and the scores that follow from them."""

    name: str
    hota: HotaCounts
    clear: ClearCounts
    identity: IdentityCounts
    recovery: RecoveryCounts  # per object
    sizes: SizeCounts
    uncertainty: UncertaintyCounts | None = None  # where the tracker can be undecided
    by_class: Mapping[str, Evaluation] = dataclasses.field(default_factory=dict)
    by_object: Sequence[Family] | None = None  # of one sequence, for intervals over its objects
    is_pooled: bool = False

    def fields(self) -> dict[str, Any]:
        """Every field at full precision; HOTA fields are arrays over its 19 thresholds.

        Names are TrackEval's where it has one.
        """
        sizes = self.sizes
        fields = {
            **hota_scores(self.hota),
            **clear_scores(self.clear, pooled=self.is_pooled),
            **identity_scores(self.identity),
            "Dets": sizes.predicted_rows,
            "GT_Dets": sizes.gt_rows,
            "IDs": sizes.predicted_ids,
            "GT_IDs": sizes.gt_ids,
            "Frames": sizes.frames,
            "RepeatedIDs": sizes.repeated_ids,
            **recovery_scores(combine.sum_counts(self.recovery)),
        }
        if self.uncertainty is not None:
            fields |= uncertainty_scores(self.uncertainty)
        return fields

    def scores(self) -> dict[str, float]:
        """One number per field (HOTA averaged over thresholds); fractions, not percent.

        NaN where undefined, such as recovery where nothing returned.
        """
        return {name: float(np.mean(value)) for name, value in self.fields().items()}

    def intervals(self, **options: Any) -> Intervals:
        """Bootstrap intervals over the objects of one sequence."""
        return {} if self.by_object is None else bootstrap_families(self.by_object, **options)

    def to_json(self) -> dict[str, Any]:
        """`{"metrics": scores}`, ready for `json.dump`; undefined scores are null."""
        return {"metrics": without_nan(self.scores())}

    def _summarize(self) -> SmallTable:
        return SmallTable(f"evaluation of '{self.name}'", **show_scores(self.scores()))


def show_scores(scores: Mapping[str, float]) -> dict[str, Any]:
    """Heads and rows of the main scores, in percent, beside the main counts."""
    rows = [
        (
            score,
            "-" if math.isnan(scores[score]) else f"{100 * scores[score]:.2f} %",
            count,
            f"{scores[count]:.0f}",
        )
        for score, count in zip(MAIN_SCORES, MAIN_COUNTS, strict=True)
    ]
    return {"heads": ("score", "", "count", ""), "rows": rows, "is_text": (0, 2)}


def evaluate_sequence(
    sequence: TrackingSequence,
    *,
    firm: TrackingSequence | None = None,
    uncertainty: UncertaintyCounts | None = None,
    num_repeated: int = 0,
    min_absence_frames: int = 1,
) -> Evaluation:
    """Scores one sequence; recovery by its firm answers, if these are others."""
    answers = collect_answers(sequence if firm is None else firm)
    recovery = count_recovery(answers, find_reference(answers), min_absence_frames)
    families = split_by_object(sequence)
    hota, clear, identity = (combine.total_counts(*family) for family in families)
    sizes = (
        len(sequence.pred),
        len(sequence.gt),
        len(sequence.pred.objects),
        len(sequence.gt.objects),
        sequence.num_frames,
        num_repeated,
    )
    return Evaluation(
        name=sequence.name,
        hota=hota,
        clear=clear,
        identity=identity,
        recovery=recovery,
        sizes=SizeCounts(*(np.asarray(size) for size in sizes)),
        uncertainty=uncertainty,
        by_object=[*families, (recovery, None)],
    )


def evaluate_classes(
    sequence: TrackingSequence, firm: TrackingSequence | None, min_absence_frames: int
) -> dict[str, Evaluation]:
    """Scores every class apart that occurs: its objects against the predictions of that class."""
    firm = sequence if firm is None else firm
    occurring = np.union1d(sequence.gt.class_index, sequence.pred.class_index)
    return {
        label: evaluate_sequence(
            sequence.select_class(label),
            firm=firm.select_class(label),
            min_absence_frames=min_absence_frames,
        )
        for label in (sequence.class_names[index] for index in occurring)
    }


def pool_evaluations(evaluations: Sequence[Evaluation], name: str = "all") -> Evaluation:
    """Adds the counts of several sequences, of each class too; ids of sequences never interact.

    Raises:
      RemindError: If there is none.
    """
    uncertain = [e.uncertainty for e in evaluations if e.uncertainty is not None]
    classes = [e.by_class for e in evaluations]
    return Evaluation(
        name=name,
        hota=combine.pool_counts(e.hota for e in evaluations),
        clear=combine.pool_counts(e.clear for e in evaluations),
        identity=combine.pool_counts(e.identity for e in evaluations),
        recovery=combine.map_counts(
            lambda *values: np.concatenate(values), *(e.recovery for e in evaluations)
        ),
        sizes=combine.pool_counts(e.sizes for e in evaluations),
        uncertainty=combine.pool_counts(uncertain) if uncertain else None,
        by_class={
            label: pool_evaluations([own[label] for own in classes if label in own], label)
            for label in dict.fromkeys(label for own in classes for label in own)
        },
        is_pooled=True,
    )


def scene_intervals(evaluations: Sequence[Evaluation], **options: Any) -> Intervals:
    """Bootstrap intervals of the pooled scores over scenes; over objects where there is one scene.

    Options are those of `combine.bootstrap_intervals`.
    """
    if len(evaluations) == 1:
        return evaluations[0].intervals(**options)
    counts = [
        (e.hota, e.clear, e.identity, combine.sum_counts(e.recovery), e.uncertainty)
        for e in evaluations
    ]
    families = [
        (combine.stack_counts(kind), None) for kind in zip(*counts, strict=True) if None not in kind
    ]
    return bootstrap_families(families, **options)


def without_nan(scores: Mapping[str, float]) -> dict[str, float | None]:
    """Scores as JSON can hold them: undefined ones are null."""
    return {name: None if math.isnan(value) else value for name, value in scores.items()}
