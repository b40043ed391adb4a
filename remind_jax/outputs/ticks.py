"""Round numbers for the axes of frames and of time: 1, 2 or 5 times a power of ten."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence

_MOST_TICKS = 12


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


def choose_step(length: float, steps: Sequence[float], most: int = _MOST_TICKS) -> float:
    """The smallest of the steps with at most so many ticks; else the largest."""
    return next((step for step in steps if length <= most * step), steps[-1])


def time_label(time_s: float, step_s: float) -> str:
    """Minutes and seconds, `1:05`, with the decimals that the step needs."""
    decimals = max(0, math.ceil(-math.log10(step_s) - 1e-9))
    minutes, seconds = divmod(round(time_s, decimals), 60)
    width = 3 + decimals if decimals else 2
    return f"{minutes:.0f}:{seconds:0{width}.{decimals}f}"


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
