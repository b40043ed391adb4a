"""Search over thresholds: Optuna proposes settings in batches, sweeps score them.

Settings, not studies, are what is kept: samplers are seeded, so that a search that is started again
with the same `out` proposes the same settings and finds their rows there.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Literal

from remind_jax.errors import SweepError, nearest_names
from remind_jax.sweeps.result import SweepResult, sign_of
from remind_jax.sweeps.settings import Setting, Value, is_range

if TYPE_CHECKING:
    import optuna

    from remind_jax.sweeps.bench import SceneBench

Space = Mapping[str, Sequence[Value]]  # as in `settings.draw`
SamplerName = Literal["tpe", "nsga2"]

_MAX_REFUSED = 300  # settings that are not allowed, while a batch is filled up
GIVEN: Setting = {}  # the configuration as it stands; the first row of every search


def search(
    bench: SceneBench,
    space: Space,
    *,
    number: int = 128,
    at_once: int = 16,
    sampler: SamplerName = "tpe",
    objectives: Sequence[str] = ("IDF1",),
    seed: int = 0,
) -> SweepResult:
    """Looks for the settings of best mean scores over the scenes.

    Args:
      space: By threshold, the least and the largest value, or three or more to choose from.
      number: Settings to try.
      at_once: Settings proposed together; a generation of "nsga2".
      objectives: Scores; several of them are traded against each other (`SweepResult.pareto`).
      seed: Same seed, same settings.

    Returns:
      The rows of the configuration as it stands and of all settings tried; `complete` is false
      after Ctrl-C.

    Raises:
      SweepError: If Optuna is missing, or the search cannot be done as asked.
    """
    if number < 1 or at_once < 1:
        raise SweepError(
            f"a search of {number} settings, {at_once} at once, is none; give at least 1 of both"
        )
    space = bench.complete_space(space)
    study = _open_study(space, sampler, objectives, at_once, seed)
    results: list[SweepResult] = []
    tried = 0
    while tried < number:
        proposed = _propose(study, space, bench, min(at_once, number - tried))
        settings = [setting for _, setting in proposed]
        result = bench.run([GIVEN, *settings] if not tried else settings)
        results.append(result)
        if not result.complete:
            break
        standings = result.standings()[-len(proposed) :]
        for (trial, _), standing in zip(proposed, standings, strict=True):
            _tell(study, trial, [standing.scores[name] for name in objectives])
        tried += len(proposed)
    return SweepResult(
        settings=tuple(setting for result in results for setting in result.settings),
        scenes=results[0].scenes,
        rows=tuple(rows for result in results for rows in result.rows),
        batch=max(result.batch for result in results),
        program_bytes=max(result.program_bytes for result in results),
        complete=all(result.complete for result in results),
    )


def _open_study(
    space: Space, sampler: SamplerName, objectives: Sequence[str], at_once: int, seed: int
) -> optuna.Study:
    try:
        import optuna
    except ImportError as error:
        raise SweepError(
            "a search needs Optuna, which is not installed; pip install 'remind-jax[sweep]'"
        ) from error
    if not space:
        raise SweepError("there are no thresholds to search over; give at least one")
    for name, values in space.items():
        if len(values) < 2:
            raise SweepError(f"{name} has {len(values)} value; give its least and its largest")
    signs = [sign_of(name) for name in objectives]
    if not objectives:
        raise SweepError("a search has no objective; give at least one")
    level = optuna.logging.get_verbosity()
    optuna.logging.set_verbosity(optuna.logging.WARNING)
    try:
        return optuna.create_study(
            sampler=_make_sampler(sampler, at_once, seed),
            directions=["maximize" if sign > 0 else "minimize" for sign in signs],
        )
    finally:
        optuna.logging.set_verbosity(level)


def _make_sampler(name: SamplerName, at_once: int, seed: int) -> Any:
    import optuna

    with warnings.catch_warnings():
        warnings.simplefilter("ignore", optuna.exceptions.ExperimentalWarning)
        if name == "tpe":
            # The constant liar keeps settings of one batch apart.
            return optuna.samplers.TPESampler(seed=seed, constant_liar=True)
        if name == "nsga2":
            return optuna.samplers.NSGAIISampler(population_size=max(2, at_once), seed=seed)
    raise SweepError(f"there is no sampler {name!r}; {nearest_names(name, ('tpe', 'nsga2'))}")


def _propose(study: optuna.Study, space: Space, bench: SceneBench, number: int) -> list[Any]:
    """At most so many trials with settings that are allowed; others count as bad to the study."""
    from optuna.trial import TrialState

    proposed, num_refused, fault = [], 0, ""
    while len(proposed) < number and num_refused < _MAX_REFUSED:
        for trial in [study.ask() for _ in range(number - len(proposed))]:
            setting = {name: _suggest(trial, name, values) for name, values in space.items()}
            fault = bench.find_fault(setting)
            if fault:
                num_refused += 1
                study.tell(trial, state=TrialState.PRUNED)
            else:
                proposed.append((trial, setting))
    if not proposed:
        raise SweepError(f"no setting that the search tries is allowed: {fault}; give other ranges")
    return proposed


def _suggest(trial: optuna.Trial, name: str, values: Sequence[Value]) -> Value:
    if not is_range(values):
        return trial.suggest_categorical(name, list(values))
    low, high = values
    if isinstance(low, int) and isinstance(high, int):
        return trial.suggest_int(name, low, high)
    return trial.suggest_float(name, float(low), float(high))


def _tell(study: optuna.Study, trial: optuna.Trial, scores: list[float]) -> None:
    """A score that no scene has is no score: the sampler learns nothing from it."""
    from optuna.trial import TrialState

    if any(math.isnan(score) for score in scores):
        study.tell(trial, state=TrialState.FAIL)
    else:
        study.tell(trial, scores)
