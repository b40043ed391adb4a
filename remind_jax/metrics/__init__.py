"""Evaluation: HOTA, Identity, CLEAR, recovery; `evaluate_tracks` scores a run, `evaluate` files."""

from remind_jax.metrics.combine import bootstrap_intervals as bootstrap_intervals
from remind_jax.metrics.combine import stack_counts as stack_counts
from remind_jax.metrics.comparison import Column as Column
from remind_jax.metrics.comparison import ComparisonTable as ComparisonTable
from remind_jax.metrics.comparison import Row as Row
from remind_jax.metrics.evaluation import evaluate_sequence as evaluate_sequence
from remind_jax.metrics.evaluation import pool_evaluations as pool_evaluations
from remind_jax.metrics.run_evaluation import evaluate_tracks as evaluate_tracks
from remind_jax.metrics.scene_evaluation import SceneOptions as SceneOptions
from remind_jax.metrics.scene_evaluation import SetEvaluation as SetEvaluation
from remind_jax.metrics.scene_evaluation import compare as compare
from remind_jax.metrics.scene_evaluation import evaluate as evaluate
from remind_jax.metrics.sequence import TrackingSequence as TrackingSequence
