"""Scores predictions of any tracker against truth, in any of the known formats, scene by scene.

Several predictions of the same truth make a table, with intervals.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from remind_jax.errors import OptionError, RemindError, SourceError
from remind_jax.files import as_path
from remind_jax.files.limits import MAX_FRAMES
from remind_jax.formats.mot import DEFAULT_MOTS_CLASS, fit_texts
from remind_jax.metrics.comparison import ComparisonTable, Row
from remind_jax.metrics.evaluation import (
    Evaluation,
    Intervals,
    pool_evaluations,
    scene_intervals,
    show_scores,
    without_nan,
)
from remind_jax.metrics.opening import TEXT_FORMATS, Format, SceneSet
from remind_jax.metrics.pairing import pair_scene
from remind_jax.metrics.run_evaluation import Undecided, check_undecided, evaluate_pair
from remind_jax.metrics.run_folder import number_detections, read_tracks
from remind_jax.metrics.scene_stream import SceneScores, SceneStream, open_stream, path_name, row_of
from remind_jax.metrics.sequence import ANY_CLASS
from remind_jax.printing.small_table import SmallTable
from remind_jax.printing.words import plural
from remind_jax.settings.ranges import check_option, check_switch

COLUMNS = (
    *("HOTA", "DetA", "AssA", "IDF1", "IDP", "IDR", "MOTA", "Recovery", "HardRecovery"),
    *("IDSW", "IDs", "GT_IDs"),
)
UNCERTAIN_COLUMNS = ("FirmShare", "FirmAccuracy", "AmbiguousShare", "CandidateHitRate")

_MIN_MATCHED = 0.05  # of the detections of the side that has fewer


@dataclasses.dataclass(frozen=True)
class SceneOptions:
    """How scenes are read and scored."""

    num_frames: int | None = None  # length, for text; up to the last row if left out
    class_id: int | None = None  # class to score, for text; MOT: all, MOTS: 2, if left out
    undecided: Undecided = "strict"  # what becomes of undecided detections of a run
    by_class: bool = False  # also score every class apart, where both sides name classes
    min_absence_frames: int = 1  # processed frames out of view that make a return

    def __post_init__(self) -> None:
        for name, least in (("num_frames", 1), ("class_id", 0), ("min_absence_frames", 1)):
            if (value := getattr(self, name)) is not None:
                check_option(name, value, least, MAX_FRAMES)
        check_switch("by_class", self.by_class)

    def check_used_by(self, truth: Format, predictions: Format) -> None:
        """Refuses options for text of one format on both sides where a side is something else.

        Raises:
          OptionError: If one is given that would change nothing.
        """
        if truth == predictions and truth in TEXT_FORMATS:
            return
        for name in ("num_frames", "class_id"):
            if getattr(self, name) is not None:
                raise OptionError(
                    f"'{name}' is for truth and predictions in text of one format, here they are "
                    f"'{truth}' and '{predictions}'; leave it out, or give text (of a run, mot.txt "
                    "or mots.txt)",
                    name,
                )


@dataclasses.dataclass(frozen=True, repr=False)
class SetEvaluation(SceneScores):
    """One set of predictions: its scenes, and those that could not be scored."""

    scenes: tuple[Evaluation, ...]

    @property
    def pooled(self) -> Evaluation:
        """Counts of all scenes added; that of the one scene where there is one."""
        if len(self.scenes) == 1:
            return self.scenes[0]
        return pool_evaluations(self.scenes, self.name)

    def scores(self) -> dict[str, float]:
        """Scores of all scenes together; of failed scenes nothing enters them."""
        return self.pooled.scores() | self.scene_counts()

    def intervals(self, **options: Any) -> Intervals:
        """Bootstrap intervals by score, over scenes, or over the objects of a single scene.

        Options are `level`, `num_resamples` and `seed`.
        """
        return scene_intervals(self.scenes, **options)

    def _summarize(self) -> SmallTable:
        failed = f", {len(self.failed)} failed" if self.failed else ""
        size = "1 scene" if len(self.scenes) == 1 else f"{len(self.scenes)} scenes"
        title = f"evaluation of '{self.name}': {size}{failed}"
        return SmallTable(title, **(show_scores(self.scores()) if self.scenes else {}))

    def to_json(self) -> dict[str, Any]:
        """`{"metrics": ...}`, with `scenes` where there are several, `failed` and `notes`."""
        content: dict[str, Any] = {"metrics": without_nan(self.scores())}
        by_class = self.pooled.by_class
        if by_class:
            content["classes"] = {label: without_nan(e.scores()) for label, e in by_class.items()}
        if len(self.scenes) > 1:
            content["scenes"] = {e.name: without_nan(e.scores()) for e in self.scenes}
        return content | self.notes_json()


def evaluate(
    truth: str | Path | SceneSet,
    prediction: str | Path,
    *,
    format: Format | None = None,
    truth_format: Format | None = None,
    name: str | None = None,
    options: SceneOptions | None = None,
) -> SetEvaluation:
    """Scores predictions against truth.

    Args:
      prediction: Output of any tracker; scenes are matched by name (one scene with one scene
        whatever their names).

    Raises:
      SourceError: If nothing can be read, or every scene failed.
      RemindError: If an option is not accepted.
    """
    options = options or SceneOptions()
    check_undecided(options.undecided)
    stream = open_stream(truth, prediction, format=format, truth_format=truth_format, name=name)
    options.check_used_by(stream.truth.format, stream.predictions.format)

    results, failed, notes = stream.score(lambda s, p: _score_scene(stream, s, p, options))
    return SetEvaluation(stream.name, tuple(results.values()), failed, notes)


def _score_scene(
    stream: SceneStream, scene: str, predicted: str, options: SceneOptions
) -> tuple[Evaluation, list[str]]:
    """Reads and scores one scene; also notes about it."""
    truth, predictions = stream.truth, stream.predictions
    rows, tracks, has_classes, notes = truth.read(scene), None, True, []
    if predictions.format == "run":
        tracks = read_tracks(predictions.files[predicted])
        paired = pair_scene(rows, number_detections(tracks, rows.name))
    elif truth.format in TEXT_FORMATS and truth.format == predictions.format:
        texts = fit_texts(
            rows,
            predictions.read(predicted),
            num_frames=options.num_frames,
            class_id=options.class_id,
        )
        paired, has_classes = pair_scene(*texts), False
        if options.class_id is None and (left_out := len(rows) - len(texts[0])):
            notes.append(
                f"class {DEFAULT_MOTS_CLASS} is scored, without {plural(left_out, 'true row')} of "
                "other classes; choose by --class-id"
            )
    else:
        paired = pair_scene(rows, predictions.read(predicted))
    has_classes &= paired.sequence.class_names != (ANY_CLASS,)
    if options.by_class and not has_classes:
        notes.append("no class is scored apart: truth and predictions name none in common")
    evaluation = evaluate_pair(
        paired,
        tracks,
        undecided=options.undecided,
        by_class=options.by_class and has_classes,
        min_absence_frames=options.min_absence_frames,
    )
    notes += [*_doubt_truth(evaluation), *paired.notes]
    return dataclasses.replace(evaluation, name=scene), notes


def _doubt_truth(evaluation: Evaluation) -> list[str]:
    """A note if next to nothing overlaps, as where truth and predictions are of two scenes.

    Perfect predictions of one room of objects match less than 1 % of those of another by chance;
    any detector worth scoring finds far more.
    """
    matched = int(evaluation.clear.true_positives)
    sizes = evaluation.sizes
    count, fewer = min(
        (int(sizes.predicted_rows), "predictions"), (int(sizes.gt_rows), "true detections")
    )
    if matched >= _MIN_MATCHED * count:
        return []
    return [
        f"only {matched} of {count} {fewer} have a counterpart that overlaps by half or more: see "
        "that truth and predictions are of the same scene, frames and image size"
    ]


def compare(
    truth: str | Path,
    predictions: Mapping[str, str | Path] | Sequence[str | Path],
    *,
    format: Format | None = None,
    truth_format: Format | None = None,
    options: SceneOptions | None = None,
    num_resamples: int = 1000,
) -> ComparisonTable:
    """Scores several predictions by the same rules.

    Raises:
      SourceError: If truth or a prediction cannot be read, or every scene of one fails.
    """
    scored = [
        evaluate(truth, path, format=format, truth_format=truth_format, name=name, options=options)
        for name, path in name_predictions(predictions).items()
    ]
    return table_of(scored, num_resamples=num_resamples)


def table_of(
    evaluations: Sequence[SetEvaluation], *, num_resamples: int = 1000, title: str = ""
) -> ComparisonTable:
    """Scored sets of predictions as a table, a row each.

    Columns are `COLUMNS`, and how undecided answers fare where there are any.
    """
    rows = [row_of(one, num_resamples) for one in evaluations]
    has_soft = any(row.scores.get("FirmShare", 1.0) < 1 for row in rows)
    columns = COLUMNS + (UNCERTAIN_COLUMNS if has_soft else ())
    return ComparisonTable(rows, columns, _legend(evaluations, rows), title)


def _legend(evaluations: Sequence[SetEvaluation], rows: Sequence[Row]) -> tuple[str, ...]:
    sentences = ["Scores in percent, equal to TrackEval's; counts are of all scenes together."]
    if any(row.intervals for row in rows):
        counts = {min(len(one.scenes), 2) for one in evaluations}
        unit = "scenes" if 2 in counts else "objects"
        alone = "; of a single scene over its objects" if {1, 2} <= counts else ""
        sentences.append(f"Ranges: 95 % bootstrap intervals over {unit}{alone}.")
    sentences += [line for evaluation in evaluations for line in evaluation.list_failed()]
    notes = [note for evaluation in evaluations for note in evaluation.notes]
    for note in dict.fromkeys(notes):
        names = ", ".join(e.name for e in evaluations if note in e.notes)
        shared = len(evaluations) > 1 and notes.count(note) == len(evaluations)
        sentences.append(f"{'All' if shared else names}: {note}.")
    return tuple(sentences)


def name_predictions(
    predictions: Mapping[str, str | Path] | Sequence[str | Path],
) -> dict[str, str | Path]:
    """Predictions by name: the given one, or as much of the path as tells them apart.

    Raises:
      RemindError: If there is none, or one was given twice.
    """
    if isinstance(predictions, Mapping):
        return dict(predictions)
    if isinstance(predictions, str | Path):
        predictions = [predictions]
    if not isinstance(predictions, Iterable):
        raise RemindError(
            f"predictions are of type {type(predictions).__name__}; give paths, or paths by name"
        )
    predictions = list(predictions)
    if not predictions:
        raise RemindError("there is no prediction to compare; give at least one")
    paths = [as_path(path, "a prediction", SourceError) for path in predictions]
    for name_of in (path_name, lambda p: f"{p.parent.name}/{path_name(p)}", str):
        names = [name_of(path) for path in paths]
        if len(set(names)) == len(names):
            return dict(zip(names, paths, strict=True))
    raise RemindError("a prediction was given twice; give each once")
