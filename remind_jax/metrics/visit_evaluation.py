"""Scores several recordings of one place, tracked with one memory, as one."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from remind_jax.errors import SourceError
from remind_jax.metrics.combine import pool_counts
from remind_jax.metrics.evaluation import Evaluation, evaluate_sequence, without_nan
from remind_jax.metrics.opening import Format
from remind_jax.metrics.recovery import RecoveryCounts, recovery_scores
from remind_jax.metrics.run_evaluation import (
    Labels,
    Undecided,
    check_undecided,
    pair_with_instances,
)
from remind_jax.metrics.scene_evaluation import SceneOptions, read_pair
from remind_jax.metrics.scene_stream import open_stream
from remind_jax.metrics.sequence import TrackingSequence
from remind_jax.metrics.visits import (
    VisitCounts,
    count_visits,
    join_visits,
    split_recovery,
    visit_scores,
)
from remind_jax.printing.small_table import Printable, SmallTable
from remind_jax.tracks import Tracks

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
        notes += [f"{scene}: {note}" for note in (*read.paired.notes, *read.notes)]
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
        visit: Labels.create(tracks, undecided).apply(
            pair_with_instances(tracks, visit)[0].sequence
        )
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
