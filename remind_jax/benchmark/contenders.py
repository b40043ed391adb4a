"""Who takes part: configurations of REMIND, its ablations, and other trackers."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from pathlib import Path

from remind_jax.config import Config, list_configs, load_config
from remind_jax.errors import ConfigError, nearest_names
from remind_jax.methods import DEFAULT_METHOD, list_methods

_ABLATION = "ablation_"
_TITLES = {
    "published": "REMIND published",
    "default": "REMIND default",
    "momentum": "momentum (MASA setting)",
    "running-mean": "nearest running mean",
    "bank": "bank of 12 + Hungarian",
    "iou": "IoU",
    "plus": "REMIND plus",
}


@dataclasses.dataclass(frozen=True)
class Contender:
    """One line of the tables."""

    name: str  # as it is asked for, and its folder
    title: str  # as it is shown
    config: Config


def all_contenders() -> list[str]:
    """Names of REMIND as published and by default, its ablations, and all other trackers."""
    ablations = [name for name in list_configs() if name.startswith(_ABLATION)]
    others = [name for name in list_methods() if name != DEFAULT_METHOD]
    return ["published", "default", *ablations, *others]


def make_contenders(names: Sequence[str] = ()) -> tuple[Contender, ...]:
    """Contenders by name of a configuration, of a tracker, or of a YAML file; all if none is named.

    Another tracker runs with the default input and its own published thresholds.

    Raises:
      ConfigError: If a name is neither.
    """
    return tuple(_make(name) for name in names or all_contenders())


def _make(name: str) -> Contender:
    if name in list_methods() and name != DEFAULT_METHOD:
        return Contender(name, _TITLES.get(name, name), load_config("default").with_tracker(name))
    if Path(name).suffix not in (".yaml", ".yml") and name not in list_configs():
        hint = nearest_names(name, all_contenders())
        raise ConfigError(f"there is no method {name!r} to compare; {hint} (or give a .yaml file)")
    config = load_config(name)
    short = Path(name).stem
    if short.startswith(_ABLATION):
        return Contender(short, short.removeprefix(_ABLATION).replace("_", " "), config)
    return Contender(short, _TITLES.get(short, short), config)
