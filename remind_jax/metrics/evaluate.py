"""Scores a run, or a file of predictions, against the truth.

Main numbers are the standard ones, equal to TrackEval's, with the id that an object got at birth.
Recovery is always counted from firm answers: a set of candidates recovers nothing, and no collapse
can change that (evaluation reference, section 6).

What becomes of undecided detections (`undecided`):

* `strict`: they carry no id, so their objects count as missed in that frame. The default: it is
  what a user of the firm ids gets.
* `collapse`: each frame's soft decisions are settled in one assignment before scoring, as in the
  paper, but never outside of a candidate set (`uncertainty.collapse_frame`).
"""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np
from jaxtyping import Bool, Float, Int

from remind_jax.decision import NO_ID
from remind_jax.errors import RemindError, SourceError, nearest_names
from remind_jax.frame import NO_INSTANCE
from remind_jax.metrics.clear import ClearCounts, clear_scores, count_clear
from remind_jax.metrics.combine import pool_counts, sum_counts
from remind_jax.metrics.hota import HotaCounts, count_hota, hota_scores
from remind_jax.metrics.identity import IdentityCounts, count_identity, identity_scores
from remind_jax.metrics.mot_files import (
    FileFormat,
    load_mot_sequence,
    load_mots_sequence,
    recognise_format,
)
from remind_jax.metrics.recovery import (
    RecoveryCounts,
    collect_answers,
    count_recovery,
    find_reference,
    recovery_scores,
)
from remind_jax.metrics.sequence import TrackingSequence
from remind_jax.metrics.uncertainty import (
    FIRM,
    UncertaintyCounts,
    collapse_frame,
    count_uncertainty,
    keep_unique_labels,
    uncertainty_scores,
)
from remind_jax.tracks import Tracks

Undecided = Literal["strict", "collapse"]

FORMATS = ("mot", "mots", "kitti-mots")


@dataclasses.dataclass(frozen=True)
class SizeCounts:
    """How much was evaluated; counts of several sequences add up."""

    predicted_rows: Int[np.ndarray, "*batch"]
    gt_rows: Int[np.ndarray, "*batch"]
    predicted_ids: Int[np.ndarray, "*batch"]  # identities found
    gt_ids: Int[np.ndarray, "*batch"]  # true objects
    frames: Int[np.ndarray, "*batch"]
    repeated_ids: Int[np.ndarray, "*batch"]  # ids taken back, given twice in one frame


@dataclasses.dataclass(frozen=True)
class Evaluation:
    """All counts of one sequence, or of several pooled, and the scores that follow from them."""

    name: str
    hota: HotaCounts
    clear: ClearCounts
    identity: IdentityCounts
    recovery: RecoveryCounts  # one-to-one reference, per object
    majority_recovery: RecoveryCounts  # majority reference, per object
    sizes: SizeCounts
    uncertainty: UncertaintyCounts | None = None  # where the tracker can be undecided
    by_class: Mapping[str, Evaluation] = dataclasses.field(default_factory=dict)
    is_pooled: bool = False

    def fields(self) -> dict[str, Any]:
        """Every field at full precision; HOTA fields are arrays over its 19 thresholds.

        Names are TrackEval's where it has one. `...Majority` uses the majority reference.
        """
        majority = recovery_scores(sum_counts(self.majority_recovery))
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
            **recovery_scores(sum_counts(self.recovery)),
            "RecoveryMajority": majority["Recovery"],
            "HardRecoveryMajority": majority["HardRecovery"],
        }
        if self.uncertainty is not None:
            fields |= uncertainty_scores(self.uncertainty)
        return fields

    def scores(self) -> dict[str, float]:
        """One number per field (HOTA averaged over thresholds); fractions, not percent.

        NaN where undefined, such as recovery where nothing returned.
        """
        return {name: float(np.mean(value)) for name, value in self.fields().items()}

    def to_json(self) -> dict[str, Any]:
        """`{"metrics": scores}`, ready for `json.dump`; undefined scores are null."""
        scores = self.scores()
        return {"metrics": {k: None if math.isnan(v) else v for k, v in scores.items()}}


def evaluate_sequence(
    sequence: TrackingSequence,
    *,
    firm: TrackingSequence | None = None,
    uncertainty: UncertaintyCounts | None = None,
    num_repeated: int = 0,
    recovery_similarity: float = 0.5,
) -> Evaluation:
    """Scores one sequence.

    Args:
      sequence: Ground truth and predictions.
      firm: The same with firm answers only, for recovery; `sequence` itself if left out.
      uncertainty: Counts of undecided answers, where the tracker has them.
      num_repeated: Ids taken back before, because they were given twice in one frame.
      recovery_similarity: Least overlap at which an answer counts for recovery (the paper: 0).
    """
    answers = collect_answers(sequence if firm is None else firm, recovery_similarity)
    recovery, majority = (
        count_recovery(answers, find_reference(answers, kind))
        for kind in ("one_to_one", "majority")
    )
    sizes = (
        len(sequence.pred_id),
        len(sequence.gt_id),
        len(sequence.pred_objects),
        len(sequence.gt_objects),
        sequence.num_frames,
        num_repeated,
    )
    return Evaluation(
        name=sequence.name,
        hota=count_hota(sequence),
        clear=count_clear(sequence),
        identity=count_identity(sequence),
        recovery=recovery,
        majority_recovery=majority,
        sizes=SizeCounts(*(np.asarray(size) for size in sizes)),
        uncertainty=uncertainty,
    )


def evaluate_tracks(
    tracks: Iterable[Tracks],
    *,
    undecided: Undecided = "strict",
    by_class: bool = False,
    name: str = "run",
) -> Evaluation:
    """Scores a run whose detections carry their true instance (`Tracks.instance_ids`).

    A detection with a known instance is that object, exactly; a firm id on any other is a false
    positive. If a frame gives one id to several detections, the best-scored keeps it, the others
    count as missed, and `RepeatedIDs` says how many.

    Args:
      tracks: The frames of a run, in order; read once.
      undecided: See the head of this module.
      by_class: Also scores every class apart (`Evaluation.by_class`).
      name: Shown in messages and tables.

    Raises:
      SourceError: If no detection has a true instance, an instance occurs twice in a frame, or
        frames are not in order.
      RemindError: If `undecided` is neither of the two.
    """
    if undecided not in ("strict", "collapse"):
        raise RemindError(
            f"undecided is '{undecided}'; {nearest_names(undecided, ('strict', 'collapse'))}"
        )
    rows = [_FrameRows.create(frame) for frame in tracks]
    _check_truth(rows, name)
    labels = [row.collapsed for row in rows] if undecided == "collapse" else [r.firm for r in rows]
    evaluated, num_repeated = _join_rows(rows, labels, name)
    firm, _ = _join_rows(rows, [row.firm for row in rows], name)
    whole = evaluate_sequence(
        evaluated,
        firm=firm,
        uncertainty=_judge_uncertainty(rows),
        num_repeated=num_repeated,
    )
    if not by_class:
        return whole
    classes = {
        label: evaluate_sequence(evaluated.select_class(label), firm=firm.select_class(label))
        for label in evaluated.class_names
    }
    return dataclasses.replace(whole, by_class=classes)


def evaluate_files(
    gt_path: str | Path,
    pred_path: str | Path,
    *,
    format: FileFormat | None = None,
    num_frames: int | None = None,
    class_id: int | None = None,
) -> Evaluation:
    """Scores a file of predictions against a file of ground truth.

    Args:
      gt_path: Ground truth.
      pred_path: Predictions of any tracker, in the same format.
      format: `mot` (boxes), `mots` or `kitti-mots` (masks); recognised if left out.
      num_frames: Length of the sequence; up to the last frame of either file if left out.
      class_id: Class to evaluate. `mot`: all classes if left out; MOTS: 2, pedestrian.

    Raises:
      SourceError: If a file cannot be read or breaks the rules of its format.
      RemindError: If the format is unknown.
    """
    if format is None:
        format = recognise_format(gt_path, pred_path)
    if format == "mot":
        sequence = load_mot_sequence(gt_path, pred_path, num_frames=num_frames, class_id=class_id)
    elif format in FORMATS:
        sequence = load_mots_sequence(
            gt_path,
            pred_path,
            num_frames=num_frames,
            class_id=2 if class_id is None else class_id,
            first_frame=0 if format == "kitti-mots" else 1,
        )
    else:
        raise RemindError(f"format is '{format}'; {nearest_names(format, FORMATS)}")
    return evaluate_sequence(sequence)


def pool_evaluations(evaluations: Sequence[Evaluation], name: str = "all") -> Evaluation:
    """Adds the counts of several sequences, of each class too; ids of sequences never interact.

    Raises:
      RemindError: If there is none.
    """
    uncertain = [e.uncertainty for e in evaluations if e.uncertainty is not None]
    classes = dict.fromkeys(label for e in evaluations for label in e.by_class)
    by_class = {
        label: pool_evaluations(
            [e.by_class[label] for e in evaluations if label in e.by_class], label
        )
        for label in classes
    }
    return Evaluation(
        name=name,
        hota=pool_counts(e.hota for e in evaluations),
        clear=pool_counts(e.clear for e in evaluations),
        identity=pool_counts(e.identity for e in evaluations),
        recovery=_chain_objects([e.recovery for e in evaluations]),
        majority_recovery=_chain_objects([e.majority_recovery for e in evaluations]),
        sizes=pool_counts(e.sizes for e in evaluations),
        uncertainty=pool_counts(uncertain) if uncertain else None,
        by_class=by_class,
        is_pooled=True,
    )


@dataclasses.dataclass(frozen=True)
class _FrameRows:
    """What evaluation keeps of one frame of a run."""

    frame: int
    instance: Int[np.ndarray, "N"]
    classes: tuple[str, ...]
    outcome: Int[np.ndarray, "N"]
    firm: Int[np.ndarray, "N"]  # id, NO_ID if undecided
    collapsed: Int[np.ndarray, "N"]  # id, NO_ID if nothing was left
    score: Float[np.ndarray, "N"]
    candidate_id: Int[np.ndarray, "N C"]

    @classmethod
    def create(cls, tracks: Tracks) -> _FrameRows:
        return cls(
            frame=tracks.frame_index,
            instance=np.asarray(tracks.instance_ids),
            classes=tracks.labels,
            outcome=np.asarray(tracks.outcome),
            firm=np.where(np.isin(tracks.outcome, FIRM), tracks.object_id, NO_ID),
            collapsed=collapse_frame(
                tracks.outcome,
                tracks.object_id,
                tracks.pending_id,
                tracks.candidate_id,
                tracks.candidate_score,
            ),
            score=np.asarray(tracks.score),
            candidate_id=np.asarray(tracks.candidate_id),
        )

    @property
    def has_truth(self) -> Bool[np.ndarray, "N"]:
        return self.instance != NO_INSTANCE


def _check_truth(rows: Sequence[_FrameRows], name: str) -> None:
    if any(len(row.instance) for row in rows) and not any(row.has_truth.any() for row in rows):
        raise SourceError(
            f"{name}: no detection has a true instance id, so there is nothing to compare with; "
            "give masks with instance ids, or evaluate files against a ground-truth file"
        )
    for before, after in itertools.pairwise(rows):
        if after.frame <= before.frame:
            raise SourceError(
                f"{name}: frame {after.frame} follows frame {before.frame}; give frames in order"
            )


def _join_rows(
    rows: Sequence[_FrameRows], labels: Sequence[Int[np.ndarray, "N"]], name: str
) -> tuple[TrackingSequence, int]:
    """The run as one sequence, and how many ids had to be taken back."""
    class_names = sorted({label for row in rows for label in row.classes}) or ["object"]
    class_index = {label: index for index, label in enumerate(class_names)}
    is_gt = [row.has_truth for row in rows]
    is_pred = [keep_unique_labels(ids, row.score) for row, ids in zip(rows, labels, strict=True)]
    frame = [np.full(len(row.instance), row.frame) for row in rows]
    classes = [np.asarray([class_index[c] for c in row.classes], np.int64) for row in rows]
    keep_gt, keep_pred = _join(is_gt, bool), _join(is_pred, bool)
    frames, ids, class_ids = _join(frame), _join(labels), _join(classes)
    is_pair = keep_gt & keep_pred
    pairs = (
        (np.cumsum(keep_gt) - 1)[is_pair],
        (np.cumsum(keep_pred) - 1)[is_pair],
        np.ones(int(is_pair.sum())),
    )
    sequence = TrackingSequence.create(
        rows[-1].frame + 1 if rows else 0,
        (frames[keep_gt], _join([row.instance for row in rows])[keep_gt]),
        (frames[keep_pred], ids[keep_pred]),
        pairs,
        gt_class=class_ids[keep_gt],
        pred_class=class_ids[keep_pred],
        class_names=class_names,
        name=name,
    )
    return sequence, int((ids != NO_ID).sum() - keep_pred.sum())


def _judge_uncertainty(rows: Sequence[_FrameRows]) -> UncertaintyCounts:
    width = max((row.candidate_id.shape[1] for row in rows), default=0)
    candidates = [
        np.pad(
            row.candidate_id,
            ((0, 0), (0, width - row.candidate_id.shape[1])),
            constant_values=NO_ID,
        )
        for row in rows
    ]
    known = _join([row.has_truth for row in rows], bool)
    shown = np.concatenate(candidates) if candidates else np.zeros((0, 0), np.int64)
    return count_uncertainty(
        _join([np.full(len(row.instance), row.frame) for row in rows])[known],
        _join([row.instance for row in rows])[known],
        _join([row.outcome for row in rows])[known],
        _join([row.firm for row in rows])[known],
        shown[known],
    )


def _chain_objects(counts: Sequence[RecoveryCounts]) -> RecoveryCounts:
    fields = [field.name for field in dataclasses.fields(RecoveryCounts)]
    chained = {name: np.concatenate([getattr(c, name) for c in counts]) for name in fields}
    return RecoveryCounts(**chained)


def _join(parts: Sequence[np.ndarray], dtype: Any = np.int64) -> np.ndarray:
    return np.concatenate(parts).astype(dtype) if parts else np.zeros(0, dtype)
