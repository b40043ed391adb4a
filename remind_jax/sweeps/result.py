"""What a sweep found: a row per setting and scene, means over scenes, the best, trade-offs."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from remind_jax.errors import SweepError, nearest_names
from remind_jax.files import writing
from remind_jax.files.csv_cells import csv_text
from remind_jax.printing.small_table import Printable, SmallTable
from remind_jax.printing.words import plural
from remind_jax.sweeps.records import Row
from remind_jax.sweeps.settings import Setting

HIGH_IS_GOOD = ("IDF1", "HOTA", "AssA", "Recovery", "HardRecovery", "Firm")
LOW_IS_GOOD = ("Ambiguous", "Provisional")


def sign_of(metric: str) -> int:
    """1 where more is better, -1 where less is.

    Raises:
      SweepError: If neither is, as of the number of identities.
    """
    known = (*HIGH_IS_GOOD, *LOW_IS_GOOD)
    if metric not in known:
        raise SweepError(f"no score {metric!r} says what is best; {nearest_names(metric, known)}")
    return -1 if metric in LOW_IS_GOOD else 1


@dataclasses.dataclass(frozen=True)
class Standing:
    """A setting with its mean scores over the scenes; a score that no scene has is NaN."""

    index: int  # of the setting, in the order given
    setting: Setting
    scores: dict[str, float]


@dataclasses.dataclass(frozen=True, repr=False)
class SweepResult(Printable):
    """All rows of a sweep; settings keep the order in which they were given."""

    settings: tuple[Setting, ...]
    scenes: tuple[str, ...]
    rows: tuple[tuple[Row, ...], ...]  # [settings][scenes]
    batch: int  # settings that went side by side; 0 if nothing had to be run
    program_bytes: int  # that the compiled program needed for them
    complete: bool = True  # false after an interruption; settings without all scenes are left out

    def _summarize(self) -> SmallTable:
        size = f"{plural(len(self.settings), 'setting')} on {plural(len(self.scenes), 'scene')}"
        stopped = "" if self.complete else ", interrupted"
        if not self.rows:
            return SmallTable(f"sweep of {size}{stopped}: nothing was run")
        metric = self.metrics[0]
        return SmallTable(
            f"sweep of {size}{stopped}; best {metric} first",
            heads=("setting", *self.metrics),
            rows=[
                (show_setting(best.setting), *(show_score(best.scores[m]) for m in self.metrics))
                for best in self.best(metric, len(self.settings))
            ],
        )

    @property
    def metrics(self) -> tuple[str, ...]:
        """Names of the scores."""
        return tuple(self.rows[0][0].scores) if self.rows else ()

    def table(self) -> np.ndarray:
        """Scores `[settings, scenes, metrics]`."""
        return np.array(
            [[[row.scores[m] for m in self.metrics] for row in rows] for rows in self.rows], float
        )

    def standings(self) -> list[Standing]:
        """Every setting with its means over the scenes."""
        mean = mean_known(self.table().swapaxes(1, 2))
        return [
            Standing(index, setting, dict(zip(self.metrics, mean[index].tolist(), strict=True)))
            for index, setting in enumerate(self.settings)
        ]

    def best(self, metric: str = "IDF1", number: int = 1) -> list[Standing]:
        """The settings of best mean score; of equals the earlier.

        Raises:
          SweepError: If there is no such score, or nothing is best by it.
        """
        self._check(metric)
        sign = sign_of(metric)
        known = [s for s in self.standings() if not math.isnan(s.scores[metric])]
        return sorted(known, key=lambda s: -sign * s.scores[metric])[:number]

    def pareto(self, first: str = "IDF1", second: str = "Firm") -> list[Standing]:
        """Settings that no other one beats in both scores, best by the first one first.

        Raises:
          SweepError: If there is no such score, or nothing is best by it.
        """
        front, best = [], -math.inf
        ranked = [(self._gain(s, first), self._gain(s, second), s) for s in self.standings()]
        for one, other, standing in sorted(ranked, key=lambda row: (-row[0], -row[1])):
            if other > best and one > -math.inf:
                front.append(standing)
                best = other
        return front

    def _gain(self, standing: Standing, metric: str) -> float:
        """A score of which more is better; -inf where there is none."""
        self._check(metric)
        gain = sign_of(metric) * standing.scores[metric]
        return -math.inf if math.isnan(gain) else gain

    def to_csv(self, path: str | Path | None = None) -> str:
        """All rows as CSV, also written to a file if one is given.

        Names of scenes are guarded (`files/csv_cells.py`).
        """
        names = sorted({name for setting in self.settings for name in setting})
        lines: list[list[Any]] = [["setting", "scene", *names, *self.metrics]]
        for index, (setting, rows) in enumerate(zip(self.settings, self.rows, strict=True)):
            values = [setting.get(name, "") for name in names]
            lines += ([index, row.scene, *values, *row.scores.values()] for row in rows)
        text = csv_text(lines)
        if path is not None:
            with writing(Path(path)):
                Path(path).write_text(text, encoding="utf-8")
        return text

    def to_markdown(self, standings: Sequence[Standing] | None = None) -> str:
        """Settings and mean scores as a Markdown table; all of them if none are given."""
        chosen = self.standings() if standings is None else standings
        names = sorted({name for standing in chosen for name in standing.setting})
        rows = [
            (
                str(standing.index),
                *(_show(standing.setting.get(name, "")) for name in names),
                *(show_score(standing.scores[metric]) for metric in self.metrics),
            )
            for standing in chosen
        ]
        return markdown_table(("setting", *names, *self.metrics), rows)

    def _check(self, metric: str) -> None:
        if metric not in self.metrics:
            raise SweepError(f"there is no score {metric!r}; {nearest_names(metric, self.metrics)}")


def mean_known(scores: np.ndarray) -> np.ndarray:
    """Means over the last axis of what is known; NaN where nothing is."""
    known = ~np.isnan(scores)
    total, number = np.where(known, scores, 0.0).sum(-1), known.sum(-1)
    return np.where(number > 0, total / np.maximum(1, number), math.nan)


def markdown_table(heads: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A table as Markdown."""
    return "\n".join(f"| {' | '.join(line)} |" for line in (heads, ("---",) * len(heads), *rows))


def show_setting(setting: Setting) -> str:
    """A setting in one line."""
    return ", ".join(f"{n}={_show(value)}" for n, value in setting.items()) or "as it stands"


def _show(value: object) -> str:
    return f"{value:g}" if isinstance(value, float) else str(value)


def show_score(score: float, as_number: str = ".3f") -> str:
    """A score as tables have it; what is not known is a dash."""
    return "-" if math.isnan(score) else format(score, as_number)
