"""Scores a run of remind against truth that it did not carry itself.

All detections are matched with the truth once, undecided ones too; firm and settled identities,
and how the undecided ones are to be judged, follow from that.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Int

from remind_jax.decision import NO_ID, Outcome
from remind_jax.metrics.evaluation import Evaluation, evaluate_classes, evaluate_sequence
from remind_jax.metrics.federated import NO_COMMON_CLASS, evaluate_federated, name_categories
from remind_jax.metrics.formats.rows import TrackRows
from remind_jax.metrics.formats.run_folder import rows_of_tracks
from remind_jax.metrics.matching import EPSILON, match_frames
from remind_jax.metrics.pairing import break_down, pair_scene
from remind_jax.metrics.sequence import TrackingSequence
from remind_jax.metrics.tracks_evaluation import Undecided
from remind_jax.metrics.uncertainty import (
    FIRM,
    UncertaintyCounts,
    collapse_frame,
    count_uncertainty,
    keep_unique_labels,
)
from remind_jax.tracks import Tracks

_MATCH_THRESHOLD = 0.5


@dataclasses.dataclass(frozen=True)
class DetectionTable:
    """All detections of a run in one table.

    Letters: `D` detections, `C` candidates.
    """

    outcome: Int[np.ndarray, "D"]
    firm: Int[np.ndarray, "D"]  # id, NO_ID if undecided
    settled: Int[np.ndarray, "D"]  # id after the collapse of each frame, NO_ID if nothing was left
    candidate_id: Int[np.ndarray, "D C"]
    is_first_firm: Bool[np.ndarray, "D"]  # keeps its id where a frame gives one twice
    is_first_settled: Bool[np.ndarray, "D"]

    @classmethod
    def create(cls, tracks: Sequence[Tracks]) -> DetectionTable:
        """Reads what a run decided."""
        width = max((frame.candidate_id.shape[1] for frame in tracks), default=0)
        parts = [_describe(frame, width) for frame in tracks] or [_describe_nothing()]
        return cls(*(np.concatenate(column) for column in zip(*parts, strict=True)))


def evaluate_run(
    tracks: Sequence[Tracks],
    truth: TrackRows,
    *,
    undecided: Undecided = "strict",
    by_class: bool = False,
    by_object: bool = False,
) -> tuple[Evaluation, tuple[str, ...]]:
    """Scores a run.

    Args:
      tracks: Its frames, in order.
      truth: Of the same scene; frames that the run did not process are not evaluated.
      undecided: What becomes of undecided detections, see `tracks_evaluation`.
      by_class: Also score every class apart.
      by_object: Keep the counts of every object, for intervals over them.

    Returns:
      The evaluation, and notes about what was left out.

    Raises:
      SourceError: If frames or their sizes do not fit.
    """
    detections = DetectionTable.create(tracks)
    stops = np.cumsum([len(frame) for frame in tracks])
    numbers = [
        np.arange(stop - len(frame), stop) for frame, stop in zip(tracks, stops, strict=True)
    ]
    paired = pair_scene(truth, rows_of_tracks(tracks, numbers, truth.name))
    firm = _relabel(paired.sequence, detections.firm, detections.is_first_firm)
    settled = _relabel(paired.sequence, detections.settled, detections.is_first_settled)
    evaluated, ids = (
        (settled, detections.settled) if undecided == "collapse" else (firm, detections.firm)
    )
    kept = detections.is_first_settled if undecided == "collapse" else detections.is_first_firm
    evaluation = evaluate_sequence(
        evaluated,
        firm=firm,
        uncertainty=_judge(paired.sequence, detections),
        breakdowns=break_down(paired, evaluated),
        by_object=by_object,
        num_repeated=int((ids != NO_ID).sum() - kept.sum()),
    )
    if by_class:
        classes = evaluate_classes(evaluated, firm)
        evaluation = dataclasses.replace(evaluation, by_class=classes)
    if truth.federation is None:
        return evaluation, paired.notes
    named = name_categories(paired)
    if named is None:
        return evaluation, (*paired.notes, NO_COMMON_CLASS)
    firm = _relabel(named, detections.firm, detections.is_first_firm)
    settled = _relabel(named, detections.settled, detections.is_first_settled)
    judged = evaluate_federated(
        settled if undecided == "collapse" else firm, truth.federation, firm
    )
    return dataclasses.replace(evaluation, federated=judged), paired.notes


def _relabel(
    sequence: TrackingSequence, label: Int[np.ndarray, "D"], keep: Bool[np.ndarray, "D"]
) -> TrackingSequence:
    """The sequence of numbered detections with only those at `keep`, under their labels."""
    everything = np.ones(len(sequence.gt_id), bool)
    kept = sequence.select(everything, keep[sequence.pred_id])
    return dataclasses.replace(kept, pred_id=label[kept.pred_id].astype(np.int64))


def _judge(sequence: TrackingSequence, detections: DetectionTable) -> UncertaintyCounts:
    gt, pred, similarity = sequence.pair_gt, sequence.pair_pred, sequence.pair_similarity
    fits = similarity >= _MATCH_THRESHOLD - EPSILON
    fits &= sequence.gt_class[gt] == sequence.pred_class[pred]
    chosen = match_frames(sequence, np.where(fits, similarity, 0.0))
    number = np.full(len(sequence.gt_id), -1)
    number[gt[chosen]] = sequence.pred_id[pred[chosen]]
    seen = number >= 0
    width = detections.candidate_id.shape[1]
    outcome = np.full(len(number), int(Outcome.EMPTY))
    firm = np.full(len(number), NO_ID)
    candidates = np.full((len(number), width), NO_ID)
    outcome[seen] = detections.outcome[number[seen]]
    firm[seen] = detections.firm[number[seen]]
    candidates[seen] = detections.candidate_id[number[seen]]
    return count_uncertainty(sequence.gt_frame, sequence.gt_id, outcome, firm, candidates)


def _describe(frame: Tracks, width: int) -> tuple[np.ndarray, ...]:
    firm = np.where(np.isin(frame.outcome, FIRM), frame.object_id, NO_ID)
    settled = collapse_frame(
        frame.outcome, frame.object_id, frame.pending_id, frame.candidate_id, frame.candidate_score
    )
    missing = width - frame.candidate_id.shape[1]
    candidates = np.pad(frame.candidate_id, ((0, 0), (0, missing)), constant_values=NO_ID)
    return (
        np.asarray(frame.outcome),
        firm,
        settled,
        candidates,
        keep_unique_labels(firm, frame.score),
        keep_unique_labels(settled, frame.score),
    )


def _describe_nothing() -> tuple[np.ndarray, ...]:
    none = np.zeros(0, np.int64)
    return none, none, none, np.zeros((0, 0), np.int64), none.astype(bool), none.astype(bool)
