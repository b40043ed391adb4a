"""Several predictions of the same truth in one table, with intervals."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

from remind_jax.errors import RemindError, SourceError
from remind_jax.files import as_path
from remind_jax.metrics.comparison import ComparisonTable, Row
from remind_jax.metrics.opening import Format
from remind_jax.metrics.scene_evaluation import (
    SceneOptions,
    SetEvaluation,
    evaluate,
)
from remind_jax.metrics.scene_stream import path_name

COLUMNS = (
    "HOTA",
    "DetA",
    "AssA",
    "IDF1",
    "IDP",
    "IDR",
    "MOTA",
    "Recovery",
    "HardRecovery",
    "IDSW",
    "IDs",
    "GT_IDs",
)
UNCERTAIN_COLUMNS = ("FirmShare", "FirmAccuracy", "AmbiguousShare", "CandidateHitRate")


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
    chosen = dataclasses.replace(options or SceneOptions(), by_object=True)
    return table_of(
        evaluate_all(truth, predictions, format, truth_format, chosen), num_resamples=num_resamples
    )


def evaluate_all(
    truth: str | Path,
    predictions: Mapping[str, str | Path] | Sequence[str | Path],
    format: Format | None,
    truth_format: Format | None,
    options: SceneOptions,
) -> list[SetEvaluation]:
    """Scores several predictions by the same rules; arguments as of `evaluate`."""
    return [
        evaluate(truth, path, format=format, truth_format=truth_format, name=name, options=options)
        for name, path in name_predictions(predictions).items()
    ]


def table_of(
    evaluations: Sequence[SetEvaluation],
    *,
    num_resamples: int = 1000,
    title: str = "",
) -> ComparisonTable:
    """Scored sets of predictions as a table, a row each.

    Columns are `COLUMNS`, and how undecided answers fare where there are any.
    """
    rows = [_row(evaluation, num_resamples) for evaluation in evaluations]
    has_soft = any(row.scores.get("FirmShare", 1.0) < 1 for row in rows)
    columns = COLUMNS + (UNCERTAIN_COLUMNS if has_soft else ())
    return ComparisonTable(rows, columns, _legend(evaluations, rows), title)


def _row(evaluation: SetEvaluation, num_resamples: int) -> Row:
    intervals = evaluation.intervals(num_resamples=num_resamples) if num_resamples else {}
    return Row(evaluation.name, evaluation.scores(), intervals, evaluation.failure_note)


def _legend(evaluations: Sequence[SetEvaluation], rows: Sequence[Row]) -> tuple[str, ...]:
    sentences = ["Scores in percent, equal to TrackEval's; counts are of all scenes together."]
    if any(row.intervals for row in rows):
        unit = "scenes" if len(evaluations[0].scenes) > 1 else "objects"
        sentences.append(f"Ranges: 95 % bootstrap intervals over {unit}.")
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
