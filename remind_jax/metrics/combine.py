"""From the counts of many sequences, objects or classes to one number and its uncertainty.

Counts are dataclasses of arrays; a leading axis runs over the units that are added or resampled.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterable, Mapping
from typing import Any, TypeVar

import numpy as np
from jaxtyping import Float

from remind_jax.errors import RemindError

Counts = TypeVar("Counts", bound=Any)
Scores = Mapping[str, Any]


def map_counts(change: Callable[..., Any], *counts: Counts) -> Counts:
    """Counts whose fields are made from the same fields of the given ones."""
    changed = {
        field.name: change(*(getattr(unit, field.name) for unit in counts))
        for field in dataclasses.fields(counts[0])
    }
    return type(counts[0])(**changed)


def stack_counts(counts: Iterable[Counts]) -> Counts:
    """Counts of several units as one, with a leading axis over the units.

    Raises:
      RemindError: If there is none.
    """
    units = list(counts)
    if not units:
        raise RemindError("there is nothing to combine; give the counts of at least one sequence")
    return map_counts(lambda *values: np.stack(values), *units)


def sum_counts(counts: Counts) -> Counts:
    """Adds the units of a leading axis."""
    return map_counts(lambda values: np.asarray(values).sum(axis=0), counts)


def total_counts(of_units: Counts, rest: Counts) -> Counts:
    """The sum over the units of a leading axis and what belongs to none of them."""
    return map_counts(np.add, sum_counts(of_units), rest)


def pool_counts(counts: Iterable[Counts]) -> Counts:
    """Adds the counts of several sequences."""
    return sum_counts(stack_counts(counts))


def ratio(part: Any, whole: Any) -> Float[np.ndarray, "*batch"]:
    """Part of a whole, NaN where the whole is 0."""
    whole = np.asarray(whole)
    return np.where(whole > 0, part / np.where(whole > 0, whole, 1), np.nan)


def resample_counts(counts: Counts, num_resamples: int, seed: int) -> Counts:
    """Draws the units of the leading axis with replacement and pools every draw.

    The same seed gives the same draws, whatever the kind of counts.
    """
    num_units = len(np.asarray(getattr(counts, dataclasses.fields(counts)[0].name)))
    rng = np.random.default_rng(seed)
    times_drawn = rng.multinomial(num_units, np.full(num_units, 1 / num_units), num_resamples)
    return map_counts(lambda values: np.tensordot(times_drawn, values, axes=1), counts)


def bootstrap_intervals(
    counts: Counts,
    score: Callable[[Counts], Scores],
    *,
    remainder: Counts | None = None,
    level: float = 0.95,
    num_resamples: int = 1000,
    seed: int = 0,
) -> dict[str, tuple[float, float]]:
    """Percentile bootstrap intervals of pooled scores; thresholds (last axis) are averaged.

    Args:
      counts: Leading axis over the units to resample: sequences (`stack_counts`) or objects.

    Returns:
      Lower and upper end by name; NaN for a score that is undefined in every draw.

    Raises:
      RemindError: If `level` is not between 0 and 1, or `num_resamples` is below 1.
    """
    if not 0 < level < 1:
        raise RemindError(f"level is {level}; it must lie between 0 and 1, such as 0.95")
    if num_resamples < 1:
        raise RemindError(f"num_resamples is {num_resamples}; give 1 or more, such as 1000")
    ends = 50 * (1 - level), 50 * (1 + level)
    drawn = resample_counts(counts, num_resamples, seed)
    if remainder is not None:
        drawn = map_counts(np.add, drawn, remainder)
    intervals = {}
    for name, values in score(drawn).items():
        values = np.asarray(values, float).reshape(num_resamples, -1).mean(axis=1)
        values = values[np.isfinite(values)]
        low, high = np.percentile(values, ends) if len(values) else (np.nan, np.nan)
        intervals[name] = (float(low), float(high))
    return intervals
