"""Cross-validation over scenes: a setting is reported on scenes that it was not chosen on."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence

import numpy as np

from remind_jax.errors import SweepError
from remind_jax.printing.small_table import Printable, SmallTable
from remind_jax.sweeps.result import (
    SweepResult,
    markdown_table,
    mean_known,
    show_score,
    show_setting,
    sign_of,
)
from remind_jax.sweeps.search import GIVEN
from remind_jax.sweeps.settings import Setting

Interval = tuple[float, float]
_RESAMPLES = 10_000


@dataclasses.dataclass(frozen=True)
class Fold:
    """One scene, held out while a setting was chosen on the others."""

    scene: str
    setting: Setting
    chosen_score: float  # mean over the other scenes
    score: float  # on the scene held out
    given_score: float  # of the configuration as it stands, on the same scene; NaN if not swept


@dataclasses.dataclass(frozen=True, repr=False)
class CrossValidation(Printable):
    """What tuning brings on scenes not used for it."""

    metric: str
    folds: tuple[Fold, ...]

    @property
    def scores(self) -> np.ndarray:
        """Of the chosen settings on the scenes held out, `[folds]`."""
        return np.array([fold.score for fold in self.folds])

    @property
    def gains(self) -> np.ndarray:
        """How much better than the configuration as it stands, `[folds]`."""
        given = np.array([fold.given_score for fold in self.folds])
        return sign_of(self.metric) * (self.scores - given)

    def interval(self, of: Sequence[float] | np.ndarray | None = None) -> Interval:
        """Percentile bootstrap interval over scenes of a mean, at 95 %; NaN with one scene.

        Args:
          of: Values per fold, such as `gains`; `scores` if left out.
        """
        from scipy.stats import bootstrap

        values = np.asarray(self.scores if of is None else of, float)
        values = values[~np.isnan(values)]
        if len(values) < 2:
            return math.nan, math.nan
        if np.all(values == values[0]):
            return float(values[0]), float(values[0])
        drawn = bootstrap(
            (values,), np.mean, n_resamples=_RESAMPLES, method="percentile", rng=0
        ).confidence_interval
        return float(drawn.low), float(drawn.high)

    @property
    def heads(self) -> tuple[str, ...]:
        """Over the columns of `rows`."""
        return ("scene held out", self.metric, "as it stands", "gain", "on the others", "setting")

    def rows(self) -> list[tuple[str, ...]]:
        """The folds as text."""
        return [
            (
                fold.scene,
                show_score(fold.score),
                show_score(fold.given_score),
                show_score(gain, "+.3f"),
                show_score(fold.chosen_score),
                show_setting(fold.setting),
            )
            for fold, gain in zip(self.folds, self.gains, strict=True)
        ]

    def mean(self) -> str:
        """The means and their intervals in a sentence."""
        (low, high), (least, most) = self.interval(), self.interval(self.gains)
        gain = f"gain {mean_known(self.gains):+.3f} [{least:+.3f}, {most:+.3f}]"
        if np.all(np.isnan(self.gains)):
            gain = "no gain known without the setting {}"
        return (
            f"Mean over {len(self.folds)} scenes: {self.metric} {np.nanmean(self.scores):.3f} "
            f"[{low:.3f}, {high:.3f}], {gain} (95 %, bootstrap over scenes)"
        )

    def to_markdown(self) -> str:
        """A table of the folds, and the means with their intervals below."""
        return f"{markdown_table(self.heads, self.rows())}\n\n{self.mean()}"

    def _summarize(self) -> SmallTable:
        title = f"settings chosen on the other scenes, by {self.metric}"
        return SmallTable(title, (self.mean(),), self.heads, self.rows(), is_text=(0, 5))


def choose_without(result: SweepResult, scene: str, metric: str = "IDF1") -> int:
    """Index of the setting of best mean score over the other scenes; of equals the earlier.

    Raises:
      SweepError: If there is no other scene, or none has the score, or nothing is best by it.
    """
    column = sign_of(metric) * result.table()[:, :, result.metrics.index(metric)]
    others = [index for index, name in enumerate(result.scenes) if name != scene]
    if not others or np.all(np.isnan(column[:, others])):
        raise SweepError(f"no scene but '{scene}' has a {metric} to choose a setting by")
    return int(np.argmax(np.nan_to_num(mean_known(column[:, others]), nan=-math.inf)))


def cross_validate(result: SweepResult, metric: str = "IDF1") -> CrossValidation:
    """Chooses among the settings of a sweep on all scenes but one, and reports on that one.

    For grids and random settings, which do not depend on the scenes; what a search proposes does.

    Args:
      result: Rows of at least two scenes; the setting `{}` in it, the configuration as it stands,
        is what gains are counted from: none is known without it.
      metric: Score by which settings are chosen.

    Raises:
      SweepError: If there are fewer than two scenes, or there is no such score.
    """
    result.best(metric)  # says so if there is no such score
    table = result.table()[:, :, result.metrics.index(metric)]
    unknown = np.full(len(result.scenes), math.nan)
    given = table[result.settings.index(GIVEN)] if GIVEN in result.settings else unknown
    folds = []
    for held_out, scene in enumerate(result.scenes):
        chosen = choose_without(result, scene, metric)
        folds.append(
            Fold(
                scene,
                result.settings[chosen],
                float(mean_known(np.delete(table[chosen], held_out))),
                float(table[chosen, held_out]),
                float(given[held_out]),
            )
        )
    return CrossValidation(metric, tuple(folds))
