"""Settings of a sweep: which thresholds take which values.

A setting gives values to thresholds by their dotted names below `thresholds`, such as
`matching.match`; what it does not name keeps the value of the configuration. How names may be
written: `config/keys.py`.
"""

from __future__ import annotations

import itertools
from collections.abc import Collection, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import jax
import numpy as np

from remind_jax import files
from remind_jax.config import Config
from remind_jax.config.dotted_keys import flatten, flatten_fields, nest
from remind_jax.config.keys import THRESHOLDS, full_key
from remind_jax.errors import ConfigError

Value = float | int | bool
Setting = dict[str, Value]

_ORIGIN = "a setting of the sweep"
_MANY = 1_000_000  # settings that a grid may have


def grid(space: Mapping[str, Iterable[Value]]) -> list[Setting]:
    """All combinations of the values, the last name varying fastest.

    Raises:
      ConfigError: If there are no values, or more than a million combinations.
    """
    values = {name: list(several) for name, several in space.items()}
    for name, several in values.items():
        if not several:
            raise ConfigError(f"{name} has no values to sweep over; give at least one")
    size = int(np.prod([float(len(several)) for several in values.values()]))
    if size > _MANY:
        raise ConfigError(
            f"the grid has {size} settings, at most {_MANY} are allowed; draw settings at random "
            "or give fewer values"
        )
    return [
        dict(zip(values, chosen, strict=True)) for chosen in itertools.product(*values.values())
    ]


def draw(space: Mapping[str, Sequence[Value]], number: int, seed: int = 0) -> list[Setting]:
    """Random settings: uniform between two numbers, whole ones if both are, else one of several.

    Args:
      space: By name, the least and the largest value, or three or more to choose from.
      number: Settings.
      seed: Same seed, same settings.
    """
    random = np.random.default_rng(seed)

    def one(values: Sequence[Value]) -> Value:
        is_range = len(values) == 2 and not isinstance(values[0], bool)
        if not is_range:
            return values[int(random.integers(len(values)))]
        low, high = values
        if isinstance(low, int) and isinstance(high, int):
            return int(random.integers(low, high + 1))
        return float(random.uniform(low, high))

    return [{name: one(values) for name, values in space.items()} for _ in range(number)]


def parse_values(text: str) -> list[Value]:
    """Values as written on a command line: `0.5,0.6`, `true,false` or `0.5:0.8:0.1`, ends included.

    Raises:
      ConfigError: If the text is neither.
    """
    words = {"true": True, "false": False}

    def number(word: str) -> Value:
        word = word.strip().lower()
        if word in words:
            return words[word]
        try:
            return int(word) if word.lstrip("+-").isdigit() else float(word)
        except ValueError as error:
            raise ConfigError(
                f"{word!r} in {text!r} is no value; write 0.5,0.6 or true,false or first:last:step"
            ) from error

    if ":" not in text:
        return [number(word) for word in text.split(",")]
    parts = [number(word) for word in text.split(":")]
    if len(parts) != 3 or any(isinstance(part, bool) for part in parts) or not parts[2] > 0:
        raise ConfigError(f"{text!r} is no range; write first:last:step with a step above 0")
    first, last, step = parts
    count = int(np.floor((last - first) / step + 1e-9)) + 1
    whole = all(isinstance(part, int) for part in parts)
    steps = [first + step * index for index in range(max(0, count))]
    return steps if whole else [float(f"{value:.12g}") for value in steps]


def read_settings(path: str | Path) -> list[Setting]:
    """Settings from a CSV file with one column per threshold, or a JSON file with a list of them.

    Raises:
      ConfigError: If the file cannot be read as such.
    """
    import csv
    import json

    path = Path(path)
    try:
        text = files.read_text(path)
    except OSError as error:
        raise ConfigError(f"cannot read settings from '{path}': {error.strerror}") from error
    if path.suffix.lower() != ".json":
        rows = list(csv.DictReader(text.splitlines()))
        if not rows:
            raise ConfigError(
                f"'{path}' holds no settings; its first row names thresholds, and every row below "
                "it is a setting"
            )
        return [{name: parse_values(value)[0] for name, value in row.items()} for row in rows]
    try:
        found = json.loads(text)
    except json.JSONDecodeError as error:
        raise ConfigError(f"'{path}' is not valid JSON: {error}") from error
    if not isinstance(found, list) or not all(isinstance(row, dict) for row in found):
        raise ConfigError(f"'{path}' must hold a list of objects, one per setting")
    return [dict(flatten(row)) for row in found]


def complete(settings: Sequence[Mapping[str, Value]], config: Config) -> list[Setting]:
    """The settings under full names below `thresholds`, each checked against the configuration.

    Raises:
      ConfigError: If there is none, or a threshold is unknown or its value of the wrong kind.
    """
    if not settings:
        raise ConfigError("there are no settings to sweep over; give at least one")
    known = frozenset(config.keys)
    names = {name for setting in settings for name in setting}
    full = {name: _threshold(name, known, config) for name in names}
    checked = []
    for setting in settings:
        named = {full[name]: value for name, value in setting.items()}
        if len(named) < len(setting):
            raise ConfigError(f"{_ORIGIN} gives a threshold twice: {', '.join(setting)}")
        values = dict(
            flatten_fields(config.updated({"thresholds": nest(named)}, _ORIGIN).thresholds)
        )
        checked.append({name: values[name] for name in named})
    return checked


def _threshold(name: str, known: Collection[str], config: Config) -> str:
    """The name below `thresholds`."""
    key = full_key(name, known, config.tracker, _ORIGIN)
    if not key.startswith(THRESHOLDS):
        raise ConfigError(
            f"{key} is no threshold and cannot be swept; run once for each of its values"
        )
    return key.removeprefix(THRESHOLDS)


def stack(thresholds: Any, settings: Sequence[Mapping[str, Value]], scalar: Any) -> Any:
    """All settings as one pytree of thresholds, each of them an array `[settings]`.

    Args:
      thresholds: Values of what a setting does not name.
      settings: From `complete`.
      scalar: Type of numbers that are not whole.
    """
    kinds = {bool: np.bool_, int: np.int32, float: scalar}
    leaves, structure = jax.tree_util.tree_flatten_with_path(thresholds)

    def column(path: Sequence[Any], value: Value) -> np.ndarray:
        name = ".".join(key.name for key in path)
        values = [setting.get(name, value) for setting in settings]
        return np.asarray(values, kinds[type(value)])

    return jax.tree.unflatten(structure, [column(path, value) for path, value in leaves])
