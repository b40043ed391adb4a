"""Scores recordings of one place that were tracked with one memory, one after another.

Of the objects of a later visit that an earlier one saw, *recognized* are those called most often by
their id from there, and *at once* those called so at first sight; *falsely recognized* are, of all
objects, those called most often by an id that belongs to another one. Which id belongs to whom is
the one-to-one assignment of recovery over all earlier visits.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from remind_jax.errors import SourceError
from remind_jax.metrics.combine import pool_counts, ratio
from remind_jax.metrics.evaluation import Evaluation, evaluate_sequence
from remind_jax.metrics.recovery import (
    NO_LABEL,
    Answers,
    RecoveryCounts,
    collect_answers,
    count_recovery,
    find_reference,
    recovery_scores,
)
from remind_jax.metrics.run_evaluation import Labels, pair_with_instances
from remind_jax.metrics.sequence import Side, TrackingSequence
from remind_jax.tracks import Tracks


@dataclasses.dataclass(frozen=True)
class VisitCounts:
    """Objects of all visits but the first; one that is in two of them counts twice."""

    objects: Float[np.ndarray, "*batch"]
    returning: Float[np.ndarray, "*batch"]  # of these, seen in an earlier visit
    recognized: Float[np.ndarray, "*batch"]  # of the returning
    recognized_at_once: Float[np.ndarray, "*batch"]
    falsely_recognized: Float[np.ndarray, "*batch"]  # of all objects


def join_visits(visits: Sequence[TrackingSequence], name: str) -> TrackingSequence:
    """The visits as one sequence, one after another, with an empty frame between two.

    Raises:
      SourceError: If there are fewer than two visits.
    """
    if len(visits) < 2:
        raise SourceError(f"{name} is {len(visits)} visit; give two or more to compare")
    names = tuple(dict.fromkeys(label for visit in visits for label in visit.class_names))
    columns: list[tuple[np.ndarray, ...]] = []
    num_frames = num_truth = num_predicted = 0
    for visit in visits:
        class_of = np.array([names.index(label) for label in visit.class_names], np.int64)
        sides = (
            (s.frame + num_frames, s.id, class_of[s.class_index]) for s in (visit.gt, visit.pred)
        )
        pairs = visit.pair_gt + num_truth, visit.pair_pred + num_predicted, visit.pair_similarity
        columns.append((*(column for side in sides for column in side), *pairs))
        num_frames += visit.num_frames + 1
        num_truth += len(visit.gt)
        num_predicted += len(visit.pred)
    joined = [np.concatenate(column) for column in zip(*columns, strict=True)]
    gt, pred = Side(num_frames - 1, *joined[:3]), Side(num_frames - 1, *joined[3:6])
    return TrackingSequence(gt, pred, joined[6], joined[7], joined[8], names, name)


def count_visits(visits: Sequence[TrackingSequence]) -> list[VisitCounts]:
    """Counts of every visit but the first."""
    counts = []
    for number in range(1, len(visits)):
        joined = collect_answers(join_visits(visits[: number + 1], "visits"))
        start = sum(visit.num_frames + 1 for visit in visits[:number])
        counts.append(_count_visit(joined, start))
    return counts


def split_recovery(
    visits: Sequence[TrackingSequence],
) -> tuple[RecoveryCounts, RecoveryCounts]:
    """Returns within a visit, and returns in a later visit than that of the last sight.

    Ids are judged by one reference for all visits; the two add up to the recovery of the whole.
    """
    answers = collect_answers(join_visits(visits, "visits"))
    reference = find_reference(answers)
    whole = count_recovery(answers, reference)
    within = [np.zeros(3)]
    start = 0
    for visit in visits:
        mine = (answers.frame >= start) & (answers.frame < start + visit.num_frames)
        here = _select(answers, mine)
        kept = np.isin(answers.objects, here.objects)
        counts = count_recovery(here, reference[kept])
        within.append(np.array([column.sum() for column in dataclasses.astuple(counts)]))
        start += visit.num_frames + 1
    inside = np.sum(within, axis=0)
    total = np.array([column.sum() for column in dataclasses.astuple(whole)])
    return RecoveryCounts(*inside), RecoveryCounts(*(total - inside))


def visit_scores(counts: VisitCounts) -> dict[str, Any]:
    """Shares and what they were counted from; NaN where nothing returned."""
    return {
        "Recognized": ratio(counts.recognized, counts.returning),
        "RecognizedAtOnce": ratio(counts.recognized_at_once, counts.returning),
        "FalseRecognitions": ratio(counts.falsely_recognized, counts.objects),
        "LaterObjects": counts.objects,
        "ReturningObjects": counts.returning,
    }


def _count_visit(answers: Answers, start: int) -> VisitCounts:
    """Counts of the visit that begins at a frame, beside all before it."""
    earlier = _select(answers, answers.frame < start)
    now = _select(answers, answers.frame >= start)
    own = dict(zip(earlier.objects.tolist(), find_reference(earlier).tolist(), strict=True))
    owner = {label: one for one, label in own.items() if label != NO_LABEL}
    recognized = at_once = false = returning = 0
    for one in now.objects.tolist():
        rows = np.flatnonzero(now.gt_id == one)
        rows = rows[np.argsort(now.frame[rows], kind="stable")]
        called = _most_frequent(now.label[rows])
        known = own.get(one, NO_LABEL)
        returning += one in own
        recognized += known != NO_LABEL and called == known
        at_once += known != NO_LABEL and int(now.label[rows[0]]) == known
        false += called in owner and owner[called] != one
    counts = (len(now.objects), returning, recognized, at_once, false)
    return VisitCounts(*(np.array(count, float) for count in counts))


def _most_frequent(label: Int[np.ndarray, "N"]) -> int:
    """The label that occurs most often, of equals the first; NO_LABEL if there is none."""
    said = label[label != NO_LABEL].tolist()
    return max(dict.fromkeys(said), key=said.count, default=NO_LABEL)


def _select(answers: Answers, rows: np.ndarray) -> Answers:
    return dataclasses.replace(
        answers,
        frame=answers.frame[rows],
        gt_id=answers.gt_id[rows],
        label=answers.label[rows],
        similarity=answers.similarity[rows],
        gt_class=answers.gt_class[rows],
    )


@dataclasses.dataclass(frozen=True)
class VisitScores:
    """Several visits of one place."""

    joined: Evaluation  # all visits as one sequence
    within: RecoveryCounts  # returns in the visit of the last sight
    across: RecoveryCounts  # returns in a later one
    counts: list[VisitCounts]  # of every visit but the first

    def scores(self) -> dict[str, float]:
        """Those of all visits as one, with recovery within and across visits apart."""
        parts = {
            f"{name}{where}": float(value)
            for where, counts in (("WithinVisits", self.within), ("AcrossVisits", self.across))
            for name, value in recovery_scores(counts).items()
        }
        shares = visit_scores(pool_counts(self.counts))
        return self.joined.scores() | parts | {name: float(v) for name, v in shares.items()}


def score_visits(runs: Mapping[str, Sequence[Tracks]]) -> VisitScores:
    """Scores runs of one place as one: an id must mean the same in all of them.

    Detections carry their true instance; undecided ones have no id.

    Raises:
      SourceError: If there are fewer than two runs, or one has no true instances.
    """
    visits = [
        Labels.create(tracks, "strict").apply(pair_with_instances(tracks, visit).sequence)
        for visit, tracks in runs.items()
    ]
    joined = evaluate_sequence(join_visits(visits, "visits"))
    return VisitScores(joined, *split_recovery(visits), count_visits(visits))
