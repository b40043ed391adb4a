"""Who takes part: the default, configurations of REMIND, ablations, and other trackers."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from pathlib import Path

from remind_jax.config import Config, list_configs, load_config
from remind_jax.errors import ConfigError, nearest_names
from remind_jax.method import PAPER_METHOD, get_method, list_methods

_ABLATION = "ablation_"
_TITLES = {  # of configurations
    "default": "REMIND plus (default)",
    "remind": "REMIND",
    "published": "REMIND published",
    "plus": "REMIND plus",
}


@dataclasses.dataclass(frozen=True)
class Contender:
    """One line of the tables."""

    name: str  # as it is asked for, and its folder
    title: str  # as it is shown
    config: Config


def all_contenders() -> list[str]:
    """Names of the default, of REMIND, of all ablations, and of all other trackers."""
    configs = list_configs()
    ablations = [name for name in configs if name.startswith(_ABLATION)]
    others = [name for name in list_methods() if name not in configs]
    return ["default", PAPER_METHOD, "published", *ablations, *others]


def make_contenders(names: Sequence[str] = ()) -> tuple[Contender, ...]:
    """Contenders by name of a configuration, of a tracker, or of a YAML file; all if none is named.

    A tracker without a configuration of its name runs with the default input and its own published
    thresholds.

    Raises:
      ConfigError: If a name is neither, or two would share a row.
    """
    made = tuple(_make(name) for name in names or all_contenders())
    called = [one.name for one in made]
    if twice := next((name for name in called if called.count(name) > 1), None):
        raise ConfigError(
            f"two methods to compare are called {twice!r}; name one only, or rename its file"
        )
    titles = [one.title for one in made]
    return tuple(
        one if titles.count(one.title) == 1 else dataclasses.replace(one, title=one.name)
        for one in made
    )


def _make(name: str) -> Contender:
    if name in list_methods() and name not in list_configs():
        title = get_method(name).title or name
        return Contender(name, title, load_config("default").with_tracker(name))
    if Path(name).suffix not in (".yaml", ".yml") and name not in list_configs():
        hint = nearest_names(name, all_contenders())
        raise ConfigError(f"there is no method {name!r} to compare; {hint} (or give a .yaml file)")
    short = Path(name).stem
    if short != name and short in (*list_configs(), *list_methods()):
        raise ConfigError(
            f"file {name!r} is called like the shipped method {short!r}; rename it, or name the "
            "method without a suffix"
        )
    config = load_config(name)
    if short.startswith(_ABLATION):
        what = short.removeprefix(_ABLATION).removeprefix(f"{config.tracker}_")
        title = f"{config.tracker}: {what.replace('_', ' ')}"  # `plus: no layout`
        return Contender(short, title, config)
    return Contender(short, _TITLES.get(short, short), config)
