"""Scores a run whose detections carry their true instance (ground-truth masks).

What becomes of undecided detections (`undecided`):

* `strict`: they carry no id, so their objects count as missed in that frame. The default: it is
  what a user of the firm ids gets.
* `collapse`: each frame's soft decisions are settled in one assignment before scoring, as in the
  paper, but never outside of a candidate set (`uncertainty.collapse_frame`).
"""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Iterable, Sequence
from typing import Any, Literal

import numpy as np
from jaxtyping import Bool, Float, Int

from remind_jax.decision import NO_ID
from remind_jax.errors import RemindError, SourceError, nearest_names
from remind_jax.frame import NO_INSTANCE
from remind_jax.metrics.breakdowns import count_breakdowns
from remind_jax.metrics.evaluation import Evaluation, evaluate_classes, evaluate_sequence
from remind_jax.metrics.sequence import TrackingSequence
from remind_jax.metrics.uncertainty import (
    FIRM,
    UncertaintyCounts,
    collapse_frame,
    count_uncertainty,
    keep_unique_labels,
)
from remind_jax.tracks import Tracks

Undecided = Literal["strict", "collapse"]


def evaluate_tracks(
    tracks: Iterable[Tracks],
    *,
    undecided: Undecided = "strict",
    by_class: bool = False,
    by_object: bool = False,
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
      by_object: Also keeps the counts of every object, for intervals over them.
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
        breakdowns=count_breakdowns(
            evaluated,
            area_share=_join([row.area_share[row.has_truth] for row in rows], float),
            gt_class=evaluated.gt_class,
            class_names=evaluated.class_names,
        ),
        num_repeated=num_repeated,
        by_object=by_object,
    )
    if not by_class:
        return whole
    return dataclasses.replace(whole, by_class=evaluate_classes(evaluated, firm))


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
    area_share: Float[np.ndarray, "N"]  # of the frame

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
            area_share=np.asarray(tracks.areas) / max(1, int(np.prod(tracks.frame_size))),
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


def _join(parts: Sequence[np.ndarray], dtype: Any = np.int64) -> np.ndarray:
    return np.concatenate(parts).astype(dtype) if parts else np.zeros(0, dtype)
