"""Evaluation: HOTA, Identity, CLEAR, recovery; `evaluate_tracks` scores a run, `evaluate` files."""

from remind_jax.metrics.columns import Column
from remind_jax.metrics.combine import average_classes, bootstrap_intervals, stack_counts
from remind_jax.metrics.comparison import ComparisonTable, Row
from remind_jax.metrics.evaluation import Evaluation, evaluate_sequence, pool_evaluations
from remind_jax.metrics.recovery import Answers, count_recovery, find_reference
from remind_jax.metrics.run_evaluation import evaluate_tracks
from remind_jax.metrics.scene_comparison import compare, table_of
from remind_jax.metrics.scene_evaluation import (
    SceneOptions,
    SetEvaluation,
    evaluate,
    evaluate_files,
)
from remind_jax.metrics.sequence import TrackingSequence

__all__ = [
    "Answers",
    "Column",
    "ComparisonTable",
    "Evaluation",
    "Row",
    "SceneOptions",
    "SetEvaluation",
    "TrackingSequence",
    "average_classes",
    "bootstrap_intervals",
    "compare",
    "count_recovery",
    "evaluate",
    "evaluate_files",
    "evaluate_sequence",
    "evaluate_tracks",
    "find_reference",
    "pool_evaluations",
    "stack_counts",
    "table_of",
]
