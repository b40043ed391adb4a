"""How much each threshold matters by itself, around the configuration as it stands."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from remind_jax.errors import SweepError
from remind_jax.method import PAPER_METHOD
from remind_jax.settings.ranges import check_option
from remind_jax.sweeps.result import SweepResult, markdown_table, show_score, sign_of
from remind_jax.sweeps.search import GIVEN, Space
from remind_jax.sweeps.settings import MAX_SETTINGS, Setting, Value, is_range

if TYPE_CHECKING:
    from remind_jax.sweeps.bench import SceneBench

# Thresholds of the paper's table (supplement), by the range around the published value in which a
# user might set them.
PAPER_SPACE: dict[str, tuple[Value, Value]] = {
    "perception.trim_keep": (0.25, 1.0),
    "perception.part_merge": (0.65, 0.95),
    "perception.ring_inner": (2, 5),
    "perception.ring_outer": (5, 9),
    "appearance.duplicate": (0.80, 0.98),
    "appearance.merge": (0.80, 0.98),
    "background.duplicate": (0.80, 0.98),
    "background.merge": (0.80, 0.98),
    "background.update_rate_min": (0.0, 0.10),
    "parts.duplicate": (0.80, 0.98),
    "parts.merge": (0.80, 0.98),
    "parts.update_rate_min": (0.0, 0.15),
    "lifecycle.confirm_hits": (1, 5),
    "lifecycle.max_misses_confirmed": (2, 40),
    "similarity.object_weight": (0.2, 1.0),
    "similarity.background_weight": (0.0, 0.5),
    "similarity.parts_weight": (0.0, 0.4),
    "diagnosis.anchor_margin": (0.01, 0.20),
    "influence.positive_cap": (0.0, 0.40),
    "influence.negative_cap": (0.0, 0.30),
    "influence.rescue_visual": (0.40, 0.75),
    "matching.match": (0.55, 0.90),
    "matching.lock_score": (0.75, 0.99),
}
# Thresholds of plus that weigh its evidence and decide when it is enough, likewise.
PLUS_SPACE: dict[str, tuple[Value, Value]] = {
    "linking.overlap": (1.0, 5.0),
    "linking.look": (0.5, 3.0),
    "linking.least": (-4.0, 0.0),
    "place.weight": (0.0, 1.6),
    "place.least_doubt": (0.005, 0.1),
    "looks.gain": (0.3, 1.5),
    "looks.best": (1.5, 6.0),
    "looks.worst": (-8.0, -2.5),
    "looks.ring_weight": (0.0, 0.8),
    "layout.weight": (0.0, 1.6),
    "layout.best": (3.0, 10.0),
    "layout.moved": (-6.0, -0.5),
    "layout.covisible_weight": (0.0, 1.2),
    "decision.new": (-0.5, 3.0),
    "decision.familiarity": (0.0, 1.6),
    "decision.crowd": (0.0, 1.5),
    "decision.firm": (0.3, 0.7),
    "decision.commit_age": (3, 16),
    "decision.early_margin": (2.0, 8.0),
    "memory.novel": (0.6, 0.95),
}
SPACES: dict[str, Space] = {PAPER_METHOD: PAPER_SPACE, "plus": PLUS_SPACE}  # by tracker


@dataclasses.dataclass(frozen=True)
class Curve:
    """A score as one threshold moves and all others stay."""

    name: str
    values: tuple[Value, ...]
    scores: tuple[float, ...]
    given_score: float  # of the configuration as it stands
    metric: str = "IDF1"

    @property
    def span(self) -> float:
        """Largest less smallest score; NaN if there is none."""
        known = [score for score in (*self.scores, self.given_score) if not math.isnan(score)]
        return max(known) - min(known) if known else math.nan


def move_one_at_a_time(
    bench: SceneBench, space: Space | None = None, *, number: int = 7, metric: str = "IDF1"
) -> tuple[list[Curve], SweepResult]:
    """Moves each threshold through its range while all others stay.

    Args:
      space: Ranges or choices; those of `SPACES` for the tracker if left out.
      number: Values per range, ends included.

    Returns:
      Curves, the widest first, and the rows that they were made of.

    Raises:
      SweepError: If there is no such score, or no space for the tracker.
    """
    check_option("number", number, 2, MAX_SETTINGS)
    if not space and bench.tracker not in SPACES:
        raise SweepError(
            f"there are no usual ranges for thresholds of '{bench.tracker}'; give some with "
            "--set KEY=LOWEST,HIGHEST"
        )
    space = bench.complete_space(space or SPACES[bench.tracker])
    values = {name: spread(ends, number) for name, ends in space.items()}
    settings: list[Setting] = [{name: v} for name, several in values.items() for v in several]
    result = bench.run([GIVEN, *settings])
    if not result.complete:
        return [], result
    result.best(metric)  # says so if there is no such score
    given, *scores = (standing.scores[metric] for standing in result.standings())
    curves, first = [], 0
    for name, several in values.items():
        last = first + len(several)
        curves.append(Curve(name, tuple(several), tuple(scores[first:last]), given, metric))
        first = last
    return sorted(curves, key=lambda curve: -np.nan_to_num(curve.span)), result


def spread(values: Sequence[Value], number: int) -> list[Value]:
    """So many values of a range, evenly, ends included; choices as they are."""
    if not is_range(values):
        return list(values)
    low, high = values
    steps = np.linspace(low, high, number)
    if isinstance(low, int) and isinstance(high, int):
        return [int(value) for value in np.unique(np.rint(steps))]
    return [float(f"{value:.12g}") for value in steps]


def curves_to_markdown(curves: Sequence[Curve]) -> str:
    """One line per threshold: its range, how far the score moves, and where it is best."""
    rows = []
    for curve in curves:
        tried = [("as it stands", curve.given_score)]  # first: what is as good is no better
        tried += [(f"{v:g}", score) for v, score in zip(curve.values, curve.scores, strict=True)]
        good = sign_of(curve.metric) * np.array([score for _, score in tried])
        value, score = tried[int(np.argmax(np.nan_to_num(good, nan=-math.inf)))]
        ends = f"{curve.values[0]:g} to {curve.values[-1]:g}"
        best = ("-" if math.isnan(score) else value, show_score(score))
        rows.append(
            (curve.name, ends, show_score(curve.span), *best, show_score(curve.given_score))
        )
    heads = ("threshold", "range", "span", "best value", "best", "as it stands")
    return markdown_table(heads, rows)
