"""Settings of a sweep: which thresholds take which values.

A setting gives values to thresholds by their dotted names below `thresholds`, such as
`matching.match`; what it does not name keeps the value of the configuration. How names may be
written: `config/keys.py`.
"""

from __future__ import annotations

import contextlib
import itertools
import math
import numbers
import re
import reprlib
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

import jax
import msgspec
import numpy as np

from remind_jax import files
from remind_jax.config import Config
from remind_jax.config.dotted_keys import flatten, flatten_fields, nest
from remind_jax.config.keys import THRESHOLDS, full_key
from remind_jax.errors import ConfigError, nearest_names
from remind_jax.files import records
from remind_jax.files.csv_cells import unguard_cell

Value = float | int | bool
Setting = dict[str, Value]

_ORIGIN = "a setting of the sweep"
MAX_SETTINGS = 100_000  # of one sweep
_MAX_DRAWS = 20  # for each setting that is wanted; enough to meet all of as many
_MAX_BYTES = 64 << 20  # of a file of settings
_LARGEST = 3e38  # in single precision
_DECIMAL = re.compile(r"[-+]?([0-9]+\.?[0-9]*|\.[0-9]+)(e[-+]?[0-9]+)?")
_Rows: Any = Annotated[list[dict[str, Any]], msgspec.Meta(max_length=MAX_SETTINGS)]


def grid(space: Mapping[str, Iterable[Value]]) -> list[Setting]:
    """All combinations of the values, the last name varying fastest.

    Raises:
      ConfigError: If there are no values, or more combinations than settings are allowed.
    """
    values = {name: _as_list(name, several) for name, several in space.items()}
    for name, several in values.items():
        if not several:
            raise ConfigError(f"{name} has no values to sweep over; give at least one")
    size = int(np.prod([float(len(several)) for several in values.values()]))
    if size > MAX_SETTINGS:
        raise ConfigError(
            f"the grid has {size} settings, at most {MAX_SETTINGS} are allowed; draw settings at "
            "random or give fewer values"
        )
    return [
        dict(zip(values, chosen, strict=True)) for chosen in itertools.product(*values.values())
    ]


def as_settings(given: Any) -> list[Setting]:
    """A list of settings, or all combinations of values by threshold.

    Raises:
      ConfigError: If it is neither.
    """
    if isinstance(given, Mapping):
        return grid(given)
    if isinstance(given, Iterable) and not isinstance(given, (str, bytes)):
        return list(itertools.islice(given, MAX_SETTINGS + 2))
    raise ConfigError(
        f"settings are {reprlib.repr(given)}; give values by threshold, or a list of settings"
    )


def _as_list(name: str, values: Any) -> list[Value]:
    if not isinstance(values, Iterable) or isinstance(values, (str, bytes)):
        raise ConfigError(f"{name} has {reprlib.repr(values)} for values; give a list of them")
    return list(itertools.islice(values, MAX_SETTINGS + 1))


def draw(
    space: Mapping[str, Sequence[Value]],
    number: int,
    seed: int = 0,
    find_fault: Callable[[Setting], str] = lambda setting: "",
) -> list[Setting]:
    """Random settings: uniform between two numbers, whole ones if both are, else one of several.

    All differ; where there are not so many, or most have a fault, there are fewer.

    Args:
      space: By name, the least and the largest value, or three or more to choose from.
      seed: Same seed, same settings.
      find_fault: What is wrong with a setting (`SceneBench.find_fault`), which is drawn again then.

    Raises:
      ConfigError: If the number is out of range, a range has no values, or all have a fault.
    """
    if not 0 < number <= MAX_SETTINGS:
        raise ConfigError(f"{number} settings cannot be drawn; give 1 to {MAX_SETTINGS}")
    for name, values in space.items():
        if not len(values) or (is_range(values) and values[0] > values[1]):
            raise ConfigError(
                f"there is nothing to draw for {name} from {list(values)}; give its least and its "
                "largest value, or three or more to choose from"
            )
    random = np.random.default_rng(seed)

    def one(values: Sequence[Value]) -> Value:
        if not is_range(values):
            return values[int(random.integers(len(values)))]
        low, high = values
        if isinstance(low, numbers.Integral) and isinstance(high, numbers.Integral):
            return int(random.integers(int(low), int(high) + 1))
        return float(random.uniform(low, high))

    drawn: dict[tuple[Value, ...], Setting] = {}
    fault = ""
    for _ in range(_MAX_DRAWS * number):
        setting = {name: one(values) for name, values in space.items()}
        fault = fault if tuple(setting.values()) in drawn else find_fault(setting)
        if not fault:
            drawn.setdefault(tuple(setting.values()), setting)
        if len(drawn) == number:
            break
    if not drawn:
        raise ConfigError(f"no setting that was drawn is allowed: {fault}; give other ranges")
    return list(drawn.values())


def is_range(values: Sequence[Value]) -> bool:
    """Whether two values are the ends of a range; true and false are two to choose from."""
    return len(values) == 2 and not isinstance(values[0], bool)


def parse_values(text: str) -> list[Value]:
    """Values as written on a command line: `0.5,0.6`, `true,false` or `0.5:0.8:0.1`, ends included.

    Raises:
      ConfigError: If the text is neither.
    """
    if ":" not in text:
        values = [_read_value(word, text) for word in text.split(",")]
    else:
        values = _read_range(text)
    if len(values) > len(set(values)):
        raise ConfigError(f"{text!r} names a value twice; name each once")
    return values


def _read_value(word: str, text: str) -> Value:
    """One value in a text."""
    words = {"true": True, "false": False}
    word = word.strip().lower()
    if word in words:
        return words[word]
    with contextlib.suppress(ValueError):  # of thousands of digits
        value = int(word) if word.lstrip("+-").isdigit() else float(word)
        is_plain = _DECIMAL.fullmatch(word) is not None  # Python takes 1_000 and other digits too
        if is_plain and math.isfinite(value) and abs(value) < _LARGEST:
            return value
    raise ConfigError(
        f"{reprlib.repr(word)} in {reprlib.repr(text)} is no value; write 0.5,0.6 or true,false or "
        "first:last:step"
    )


def _read_range(text: str) -> list[Value]:
    parts = [_read_value(word, text) for word in text.split(":")]
    if len(parts) != 3 or any(isinstance(part, bool) for part in parts) or not parts[2] > 0:
        raise ConfigError(f"{text!r} is no range; write first:last:step with a step above 0")
    first, last, step = parts
    count = math.floor((last - first) / step + 1e-9) + 1
    if not 0 < count <= MAX_SETTINGS:
        raise ConfigError(
            f"{text!r} has {max(0, count)} values; 1 to {MAX_SETTINGS} are allowed, so write "
            "first:last:step with first up to last and a larger step"
        )
    whole = all(isinstance(part, int) for part in parts)
    steps = [first + step * index for index in range(count)]
    return steps if whole else [float(f"{value:.12g}") for value in steps]


def read_settings(path: str | Path) -> list[Setting]:
    """Settings of a CSV file with one column per threshold, or a JSON file with a list of them."""
    path = Path(path)
    if path.suffix.lower() == ".json":
        rows = records.read_json(path, _Rows, refused=ConfigError, max_bytes=_MAX_BYTES)
        settings = [dict(flatten(row)) for row in rows]
    else:
        settings = _read_table(path)
    if not settings:
        raise ConfigError(
            f"'{path}' holds no settings; the first row of a CSV file names thresholds, and every "
            "row below it is a setting"
        )
    seen: dict[tuple, int] = {}
    for number, setting in enumerate(settings, 1):
        for name, value in setting.items():
            if not isinstance(value, (bool, int, float)):
                raise ConfigError(
                    f"'{path}', setting {number}: {name} is {reprlib.repr(value)}; it must be a "
                    "number, true or false"
                )
        first = seen.setdefault(tuple(sorted(setting.items())), number)
        if first < number:
            raise ConfigError(
                f"'{path}': settings {first} and {number} are the same; give each once"
            )
    return settings


def _read_table(path: Path) -> list[Setting]:
    """The rows of a CSV file."""
    import csv

    try:
        text = files.read_text(path, _MAX_BYTES)
        rows = list(itertools.islice(csv.reader(text.splitlines(), strict=True), MAX_SETTINGS + 2))
    except OSError as error:
        raise ConfigError(f"cannot read settings from '{path}': {error.strerror}") from error
    except csv.Error as error:
        raise ConfigError(f"'{path}' is no CSV file: {error}") from error
    # Editors leave empty lines, at the end above all.
    names, *rows = ([unguard_cell(cell) for cell in row] for row in [*filter(None, rows)] or [[]])
    if len(rows) > MAX_SETTINGS:
        raise ConfigError(f"'{path}' holds more than {MAX_SETTINGS} settings; sweep over fewer")
    twice = next((name for name, count in Counter(names).items() if count > 1), None)
    if twice is not None:
        raise ConfigError(f"'{path}' has the column {twice!r} twice; name every threshold once")
    settings = []
    for number, row in enumerate(rows, 1):
        if len(row) != len(names):
            raise ConfigError(
                f"'{path}', setting {number}: it has {len(row)} values for {len(names)} thresholds"
            )
        try:
            values = [_read_value(word, word) for word in row]
        except ConfigError as error:
            raise ConfigError(f"'{path}', setting {number}: {error}") from error
        settings.append(dict(zip(names, values, strict=True)))
    return settings


def complete_space(space: Mapping[str, Iterable[Value]], config: Config) -> dict[str, list[Value]]:
    """What settings will be made of, checked before the first is tried.

    Values are of the kind of their threshold: 0 and 1 are the ends of a range of whole numbers only
    where the threshold takes nothing else. Which may go together is not looked at.

    Raises:
      ConfigError: If a threshold is unknown or named twice, or one of its values is not allowed.
    """
    found = {
        name: [
            value
            for setting in complete([{name: value} for value in values], config, ordered=False)
            for value in setting.values()
        ]
        for name, values in space.items()
    }
    complete([{name: values[0] for name, values in found.items()}], config, ordered=False)
    return found


def complete(
    settings: Sequence[Mapping[str, Value]], config: Config, *, ordered: bool = True
) -> list[Setting]:
    """The settings under full names below `thresholds`, each checked against the configuration.

    Unless `ordered`, a least may be above its most.

    Raises:
      ConfigError: If there is none, or a threshold is unknown or its value of the wrong kind.
    """
    if not settings:
        raise ConfigError("there are no settings to sweep over; give at least one")
    if len(settings) > MAX_SETTINGS + 1:  # beside the configuration as it stands
        raise ConfigError(
            f"there are {len(settings)} settings to sweep over; at most {MAX_SETTINGS} are allowed"
        )
    for setting in settings:
        if not isinstance(setting, Mapping) or not all(isinstance(name, str) for name in setting):
            raise ConfigError(
                f"{_ORIGIN} is {reprlib.repr(setting)}; give a mapping from thresholds to values"
            )
    known = frozenset(config.keys)
    names = {name for setting in settings for name in setting}
    full = {name: _threshold(name, known, config) for name in names}
    checked = []
    for setting in settings:
        named = {full[name]: value for name, value in setting.items()}
        if len(named) < len(setting):
            raise ConfigError(f"{_ORIGIN} gives a threshold twice: {', '.join(setting)}")
        changed = config.updated({"thresholds": nest(named)}, _ORIGIN, ordered=ordered)
        values = dict(flatten_fields(changed.thresholds))
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


def stack(
    thresholds: Any, settings: Sequence[Mapping[str, Value]], scalar: Any = np.float32
) -> Any:
    """All settings as one pytree of thresholds, each of them an array `[settings]`.

    Args:
      thresholds: Values of what a setting does not name.
      settings: By dotted name, as from `complete`.
      scalar: Type of numbers that are not whole.

    Raises:
      ConfigError: If there is no threshold of a name, or a value is of another kind.
    """
    kinds = {bool: np.bool_, int: np.int32, float: scalar}
    may_be = {bool: (bool, np.bool_), int: numbers.Integral, float: numbers.Real}
    leaves, structure = jax.tree_util.tree_flatten_with_path(thresholds)
    known = [".".join(key.name for key in path) for path, _ in leaves]
    for name in sorted({name for setting in settings for name in setting}.difference(known)):
        raise ConfigError(f"there is no threshold {name!r}; {nearest_names(name, known)}")

    def column(path: Sequence[Any], value: Value) -> np.ndarray:
        name = ".".join(key.name for key in path)
        values = [setting.get(name, value) for setting in settings]
        for one in values:
            is_switch = isinstance(one, bool | np.bool_)
            if not isinstance(one, may_be[type(value)]) or is_switch != isinstance(value, bool):
                raise ConfigError(
                    f"threshold {name!r} is {reprlib.repr(one)} in a setting; it is a value of the "
                    f"kind of {value!r}"
                )
        return np.asarray(values, kinds[type(value)])

    return jax.tree.unflatten(structure, [column(path, value) for path, value in leaves])
