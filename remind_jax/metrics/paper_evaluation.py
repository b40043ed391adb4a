"""Scores predictions by the paper's protocol, runs of remind by both of its formulas."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from remind_jax.formats.rows import UNKNOWN_CLASS, TrackRows
from remind_jax.metrics import paper
from remind_jax.metrics.combine import bootstrap_intervals, pool_counts, stack_counts
from remind_jax.metrics.comparison import ComparisonTable, Row, column_of
from remind_jax.metrics.decisions import NO_ROW, Decisions
from remind_jax.metrics.evaluation import without_nan
from remind_jax.metrics.matching import match_detections
from remind_jax.metrics.opening import Format, SceneSet
from remind_jax.metrics.pairing import pair_scene
from remind_jax.metrics.run_folder import number_detections, read_tracks
from remind_jax.metrics.scene_stream import SceneScores, SceneStream, open_stream, row_of
from remind_jax.printing.small_table import SmallTable
from remind_jax.tracks import Tracks

COLUMNS = ("IDF1", "Recovery", "HardRecovery", "IDSWRate", "DetA", "AssA", "IDP", "IDR")
_UNCERTAIN = ("FirmShare", "FirmAccuracy", "AmbiguousShare", "CandidateHitRate", "CollapseAccuracy")


@dataclasses.dataclass(frozen=True, repr=False)
class PaperEvaluation(SceneScores):
    """One set of predictions under one path of the original."""

    scenes: Mapping[str, paper.PaperCounts]
    is_remind: bool = False  # formulas for REMIND; else those for every other tracker

    @property
    def legend(self) -> tuple[str, ...]:
        """In which ways the scores are not the standard ones."""
        return paper.REMIND_LEGEND if self.is_remind else paper.GENERIC_LEGEND

    def scores(self) -> dict[str, float]:
        """Pooled over scenes, fractions; NaN where undefined.

        Other trackers than REMIND have no shares of firm and ambiguous answers.
        """
        scores = paper.paper_scores(pool_counts(self.scenes.values()))
        left_out = () if self.is_remind else (*_UNCERTAIN, "WeakShare")
        named = {**scores, **self.scene_counts()}
        return {name: float(value) for name, value in named.items() if name not in left_out}

    def _summarize(self) -> SmallTable:
        row = Row("", self.scores())
        return SmallTable(
            f"'{self.name}' under the paper's protocol",
            heads=("score", "value"),
            rows=[(c.heading, row.format(c)[0]) for c in map(column_of, row.scores)],
        )

    def to_json(self) -> dict[str, Any]:
        """`{"metrics": ..., "protocol": "paper", "legend": ...}`, `failed` and `notes`."""
        content = {
            "metrics": without_nan(self.scores()),
            "protocol": "paper",
            "legend": list(self.legend),
        }
        return content | self.notes_json()

    def intervals(self, **options: Any) -> dict[str, tuple[float, float]]:
        """Bootstrap intervals over scenes; none for one scene."""
        if len(self.scenes) < 2:
            return {}
        return bootstrap_intervals(
            stack_counts(self.scenes.values()), paper.paper_scores, **options
        )


def evaluate_paper(
    truth: str | Path | SceneSet,
    prediction: str | Path,
    *,
    format: Format | None = None,
    truth_format: Format | None = None,
    name: str | None = None,
) -> tuple[PaperEvaluation, ...]:
    """Scores one set of predictions; a run of remind by both paths, REMIND's first.

    Arguments are those of `evaluate`.

    Raises:
      SourceError: If nothing can be read, or every scene failed.
    """
    stream = open_stream(truth, prediction, format=format, truth_format=truth_format, name=name)
    results, failed, notes = stream.score(lambda s, p: _count_scene(stream, s, p))
    generic = {scene: counts[-1] for scene, counts in results.items()}
    if stream.predictions.format != "run":
        return (PaperEvaluation(stream.name, generic, failed, notes),)
    remind = {scene: counts[0] for scene, counts in results.items()}
    return (
        PaperEvaluation(stream.name, remind, failed, notes, is_remind=True),
        PaperEvaluation(f"{stream.name}, generic formulas", generic, failed),
    )


def paper_table(
    evaluations: Sequence[PaperEvaluation], *, num_resamples: int = 1000, title: str = ""
) -> ComparisonTable:
    """The paper's table of several predictions, every deviation from the standard in its legend."""
    rows = []
    for e in evaluations:
        formulas = "REMIND's formulas" if e.is_remind else "generic formulas"
        rows.append(row_of(e, num_resamples, formulas))
    legend = [sentence for e in evaluations for sentence in e.legend]
    if len({e.is_remind for e in evaluations}) > 1:
        legend.append("Rows of different formulas do not compare.")
    for e in evaluations:
        legend += [*e.list_failed(), *(f"{e.name}: {note}." for note in e.notes)]
    has_soft = any(row.scores.get("AmbiguousShare", 0.0) > 0 for row in rows)
    columns = COLUMNS + (_UNCERTAIN if has_soft else ())
    return ComparisonTable(rows, columns, tuple(dict.fromkeys(legend)), title)


def _sight(
    truth: TrackRows, prediction: TrackRows, tracks: Sequence[Tracks] | None
) -> tuple[paper.Sightings, list[str]]:
    """Matches detections with the truth, by the rule of the paper.

    Predictions are those of any tracker, or the numbered detections of a run with its tracks.
    """
    paired = pair_scene(_without_ignored(truth), _without_ignored(prediction))
    sequence = paired.sequence
    gt, pred, similarity = match_detections(sequence, 0.0, within_class=True)
    row = np.full(len(sequence.pred), NO_ROW)
    iou = np.zeros(len(sequence.pred))
    row[pred], iou[pred] = gt, similarity
    ids = sequence.pred.id
    sightings = paper.Sightings(
        gt_frame=sequence.gt.frame,
        gt_id=sequence.gt.id,
        gt_class=sequence.gt.class_index,
        frame=sequence.pred.frame,
        row=row,
        iou=iou,
        class_id=sequence.pred.class_index,
        decisions=Decisions.of_ids(ids)
        if tracks is None
        else Decisions.of_tracks(tracks).take(ids),
    )
    return sightings, list(paired.notes)


def _without_ignored(rows: TrackRows) -> TrackRows:
    """Without the classes that the original leaves out; as it is, if there are no others."""
    is_ignored = np.array(
        [n.strip().casefold() in paper.IGNORED_CLASSES for n in rows.class_names] + [False]
    )
    keep = ~is_ignored[np.where(rows.class_id == UNKNOWN_CLASS, -1, rows.class_id)]
    return rows.select(keep) if keep.any() and not keep.all() else rows


def _count_scene(
    stream: SceneStream, scene: str, predicted: str
) -> tuple[tuple[paper.PaperCounts, ...], list[str]]:
    truth, predictions = stream.truth.read(scene), stream.predictions
    if predictions.format != "run":
        sightings, notes = _sight(truth, predictions.read(predicted), None)
        return (paper.count_generic(sightings),), notes
    tracks = read_tracks(predictions.files[predicted])
    sightings, notes = _sight(truth, number_detections(tracks, truth.name), tracks)
    return (paper.count_remind(sightings), paper.count_generic(sightings)), notes
