"""Scores recordings of one place, tracked with one memory, as one (evaluation.md#visits)."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from remind_jax.errors import SourceError
from remind_jax.metrics.combine import pool_counts, ratio
from remind_jax.metrics.evaluation import Evaluation, evaluate_sequence, without_nan
from remind_jax.metrics.opening import Format
from remind_jax.metrics.recovery import (
    NO_LABEL,
    Answers,
    RecoveryCounts,
    collect_answers,
    count_recovery,
    find_reference,
    recovery_scores,
)
from remind_jax.metrics.run_evaluation import (
    Labels,
    Undecided,
    check_undecided,
    pair_with_instances,
)
from remind_jax.metrics.scene_evaluation import SceneOptions, read_pair
from remind_jax.metrics.scene_stream import open_stream
from remind_jax.metrics.sequence import TrackingSequence
from remind_jax.printing.small_table import Printable, SmallTable
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
    columns: dict[str, list[np.ndarray]] = {}
    num_frames = num_truth = num_predicted = 0
    for visit in visits:
        class_of = np.array([names.index(label) for label in visit.class_names], np.int64)
        for column, values in (
            ("gt_frame", visit.gt_frame + num_frames),
            ("gt_id", visit.gt_id),
            ("pred_frame", visit.pred_frame + num_frames),
            ("pred_id", visit.pred_id),
            ("pair_gt", visit.pair_gt + num_truth),
            ("pair_pred", visit.pair_pred + num_predicted),
            ("pair_similarity", visit.pair_similarity),
            ("gt_class", class_of[visit.gt_class]),
            ("pred_class", class_of[visit.pred_class]),
        ):
            columns.setdefault(column, []).append(values)
        num_frames += visit.num_frames + 1
        num_truth += len(visit.gt_id)
        num_predicted += len(visit.pred_id)
    joined = {column: np.concatenate(values) for column, values in columns.items()}
    return TrackingSequence(num_frames=num_frames - 1, class_names=names, name=name, **joined)


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


VISIT_HEADS = ("", "objects", "returning", "recognized", "at once", "false recognitions")


@dataclasses.dataclass(frozen=True, repr=False)
class VisitsEvaluation(Printable):
    """One set of predictions over several visits."""

    name: str
    visits: tuple[str, ...]  # names, in the order of time
    joined: Evaluation  # all visits as one sequence
    within: RecoveryCounts  # returns in the visit of the last sight
    across: RecoveryCounts  # returns in a later one
    counts: tuple[VisitCounts, ...]  # of every visit but the first
    notes: tuple[str, ...] = ()

    def scores(self) -> dict[str, float]:
        """Those of all visits as one, with recovery within and across visits apart."""
        pooled = pool_counts(self.counts)
        parts = {
            f"{name}{where}": float(value)
            for where, counts in (("WithinVisits", self.within), ("AcrossVisits", self.across))
            for name, value in recovery_scores(counts).items()
        }
        shares = {name: float(value) for name, value in visit_scores(pooled).items()}
        return self.joined.scores() | parts | shares

    def rows(self) -> list[tuple[str, ...]]:
        """Cells of a table by visit; `VISIT_HEADS` are its heads."""
        names = [*self.visits[1:], "all"] if len(self.counts) > 1 else list(self.visits[1:])
        parts = [*self.counts, pool_counts(self.counts)][: len(names)]
        return [(name, *_cells(counts)) for name, counts in zip(names, parts, strict=True)]

    def to_json(self) -> dict[str, Any]:
        """`{"metrics": ..., "visits": ...}`, with `notes` where there are any."""
        content: dict[str, Any] = {
            "metrics": without_nan(self.scores()),
            "visits": {
                name: without_nan({k: float(v) for k, v in visit_scores(counts).items()})
                for name, counts in zip(self.visits[1:], self.counts, strict=True)
            },
        }
        return content | ({"notes": list(self.notes)} if self.notes else {})

    def _summarize(self) -> SmallTable:
        title = f"evaluation of '{self.name}': {len(self.visits)} visits"
        return SmallTable(title, heads=VISIT_HEADS, rows=self.rows())


def evaluate_visits(
    truth: str | Path,
    prediction: str | Path,
    *,
    format: Format | None = None,
    truth_format: Format | None = None,
    options: SceneOptions | None = None,
) -> VisitsEvaluation:
    """Scores several recordings of one place as one: an id must mean the same in all of them.

    Raises:
      SourceError: If a side cannot be read, or a visit is missing.
    """
    options = options or SceneOptions()
    check_undecided(options.undecided)
    stream = open_stream(truth, prediction, format=format, truth_format=truth_format)
    visits, notes = [], list(stream.notes)
    for scene, predicted in sorted(stream.partner.items()):
        if predicted is None:
            raise SourceError(
                f"there is no prediction of visit '{scene}'; give one for every visit of the truth"
            )
        read = read_pair(stream, scene, predicted, options)
        sequence: TrackingSequence = read.paired.sequence
        if read.tracks is not None:
            sequence = Labels.create(read.tracks, options.undecided).apply(sequence)
        visits.append(sequence)
        notes += [f"{scene}: {note}" for note in read.paired.notes]
    return _evaluate(stream.name, dict(zip(sorted(stream.partner), visits, strict=True)), notes)


def evaluate_run_visits(
    runs: Mapping[str, Sequence[Tracks]], *, name: str = "visits", undecided: Undecided = "strict"
) -> VisitsEvaluation:
    """As `evaluate_visits`, of runs whose detections carry their true instance.

    Raises:
      SourceError: If there are fewer than two runs, or one has no true instances.
    """
    check_undecided(undecided)
    visits = {
        visit: Labels.create(tracks, undecided).apply(pair_with_instances(tracks, visit).sequence)
        for visit, tracks in runs.items()
    }
    return _evaluate(name, visits, ())


def _evaluate(
    name: str, visits: Mapping[str, TrackingSequence], notes: Sequence[str]
) -> VisitsEvaluation:
    sequences = list(visits.values())
    joined = evaluate_sequence(join_visits(sequences, name))
    within, across = split_recovery(sequences)
    counts = tuple(count_visits(sequences))
    return VisitsEvaluation(name, tuple(visits), joined, within, across, counts, tuple(notes))


def _cells(counts: VisitCounts) -> tuple[str, ...]:
    shown = {name: float(value) for name, value in visit_scores(counts).items()}
    shares = (shown[name] for name in ("Recognized", "RecognizedAtOnce", "FalseRecognitions"))
    return (
        f"{shown['LaterObjects']:.0f}",
        f"{shown['ReturningObjects']:.0f}",
        *("" if share != share else f"{100 * share:.1f} %" for share in shares),
    )
