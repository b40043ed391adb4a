"""The timeline of the report: who was seen when, who came back, what stayed undecided.

Positions count the processed frames 0, 1, 2, ...
"""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Iterator, Sequence

import numpy as np

from remind_jax.decision import Outcome
from remind_jax.outputs.presence import (
    UNDECIDED,
    Presence,
    Span,
    find_presences,
    join_positions,
)
from remind_jax.outputs.result import Result


@dataclasses.dataclass(frozen=True)
class Timeline:
    """All identities over time, sorted by first sight, and what was never decided."""

    num_frames: int
    rows: tuple[Presence, ...]
    ambiguous: tuple[Span, ...]  # frames with at least one such detection
    provisional: tuple[Span, ...]


def build_timeline(result: Result) -> Timeline:
    """Collects presence, absence and doubt from a run."""

    def frames_with(outcomes: Sequence[Outcome]) -> tuple[Span, ...]:
        return join_positions(
            position
            for position, tracks in enumerate(result.tracks)
            if np.isin(tracks.outcome, outcomes).any()
        )

    by_first_sight = sorted(find_presences(result.tracks), key=lambda row: row.seen[0][0])
    provisional = [outcome for outcome in UNDECIDED if outcome != Outcome.AMBIGUOUS]
    return Timeline(
        num_frames=len(result.tracks),
        rows=tuple(by_first_sight),
        ambiguous=frames_with([Outcome.AMBIGUOUS]),
        provisional=frames_with(provisional),
    )


def frame_steps(num_frames: int) -> list[int]:
    """Round numbers of frames, up to the first that leaves one tick."""
    return [int(step) for step in _up_to(num_frames, _round_numbers(1.0))]


def time_steps(duration_s: float) -> list[float]:
    """Round seconds and, from one minute on, round minutes; up to the first that leaves one tick.

    Args:
      duration_s: Of the axis; positive.
    """
    smallest = 10.0 ** math.floor(math.log10(duration_s) - 2)
    seconds = itertools.takewhile(lambda step: step < 50, _round_numbers(min(smallest, 1.0)))
    minutes = (60 * step for step in _round_numbers(1.0))
    return _up_to(duration_s, itertools.chain(seconds, minutes))


def _round_numbers(smallest: float) -> Iterator[float]:
    """From a power of ten on."""
    for power in itertools.count(round(math.log10(smallest))):
        for factor in (1, 2, 5):
            yield factor * 10.0**power if power >= 0 else factor / 10.0**-power


def _up_to(length: float, steps: Iterator[float]) -> list[float]:
    taken = []
    for step in steps:
        taken.append(step)
        if step >= length:
            break
    return taken
