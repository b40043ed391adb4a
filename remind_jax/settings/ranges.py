"""Which numbers a setting may have: the range of its unit, unless its record says otherwise.

Thresholds may lie beyond what can be measured, as "never" and "always" are legitimate: no cosine
reaches 2. Far beyond that a number is a mistake, and a count takes all memory or all time.
"""

from __future__ import annotations

import dataclasses
import functools
import math
import numbers
import reprlib
import typing
from collections.abc import Mapping
from typing import Any, TypeVar

from remind_jax.errors import ConfigError, OptionError, nearest_names
from remind_jax.settings.record import Setting

_Options = TypeVar("_Options")

_MEASURES = (  # of what lies in [-1, 1]
    *("agreement", "cosine", "coverage", "maturity", "quality", "reliability", "score"),
    *("share of a patch", "share of the channels", "share of the object", "share of the patches"),
    *("share of the ring", "share of the score", "similarity", "solidity", "strength"),
    "usefulness",
)
_AMOUNTS = (
    *("classes", "clusters", "decisions", "detections", "effective patches", "episodes", "factor"),
    *("frames", "hits", "length", "links", "object sizes", "objects", "pairs", "parts", "patches"),
    *("per episode", "per nat", "px", "samples", "sets", "sightings", "ticks"),
)
# By unit, the least and the largest value of a threshold.
RANGES: dict[str, tuple[float, float]] = {
    **dict.fromkeys(_MEASURES, (-1.0, 2.0)),
    **dict.fromkeys(_AMOUNTS, (0.0, 1e6)),
    "exponent": (-100.0, 100.0),
    "log odds": (-1e4, 1e4),
    "probability": (0.0, 1.0),
    "rounds": (0.0, 100.0),
    "share": (0.0, 100.0),
    "step": (0.0, 1.0),
    "support": (-1e4, 1e4),
    "weight": (0.0, 1e4),
}
# By unit, the largest count that fixes shapes. What is nested or unrolled takes time without end.
MAX_COUNTS: dict[str, int] = {
    "candidates": 1024,
    "clusters": 64,
    "clusters: fewest, most": 64,
    "detections": 10_000,
    "id": 10**9,
    "iterations": 1000,
    "numbers": 1 << 16,
    "objects": 1024,
    "parts": 64,
    "patches": 64,
    "prototypes": 1024,
    "prototypes: work, stable": 1024,
    "px": 1 << 16,
    "relations": 1024,
    "restarts": 100,
    "rounds": 16,
    "seed": 2**31 - 2,
    "sets": 1024,
    "tracks": 8192,
}

_MAX_LISTED = 10_000
_MAX_CHARACTERS = 200  # of a name


def range_of(record: Setting) -> tuple[float, float]:
    """The least and the largest value; of a unit that is not listed, any finite one."""
    least, most = RANGES.get(record.unit, (-math.inf, math.inf))
    return (
        least if record.least is None else record.least,
        most if record.most is None else record.most,
    )


def check_range(name: str, value: Any, record: Setting) -> None:
    """Checks a threshold; what is no number passes, as do arrays: they are sweeps.

    Raises:
      ConfigError: If it is not finite, or beyond its range.
    """
    if isinstance(value, (int, float)) and not isinstance(value, bool):
        _check(name, value, *range_of(record), record.why)


def _check(name: str, value: float, least: float, most: float, why: str) -> None:
    if not math.isfinite(value):
        raise ConfigError(f"{name} is {value!r}; it must be a finite number")
    if value > most:
        why = f", {why}" if why else ""
        raise ConfigError(f"{name} is {value!r}; supported: up to {most:.12g}{why}")
    if value < least:
        raise ConfigError(f"{name} is {value!r}; supported: from {least:.12g} on")


def check_order(section: Any, path: str) -> None:
    """Checks numbers of a record of settings that belong together: no least above its most.

    Raises:
      ConfigError: If there is one.
    """
    for field in dataclasses.fields(section):
        low = field.metadata.get("setting", Setting("")).not_below
        if not low:
            continue
        least, most = getattr(section, low), getattr(section, field.name)
        if all(isinstance(value, (int, float)) for value in (least, most)) and least > most:
            raise ConfigError(
                f"{path}{low} is {least!r} and {path}{field.name} {most!r}; the first may not be "
                "above the second"
            )


def check_switch(name: str, value: Any) -> None:
    """Checks what is either true or false."""
    if not isinstance(value, bool):
        raise OptionError(f"'{name}' is {reprlib.repr(value)}; give True or False", name)


def read_options(name: str, given: Any, kind: type[_Options]) -> _Options:
    """Options as their dataclass, from it or from a mapping of some.

    Raises:
      ConfigError: If it is neither, or has an option that there is not.
    """
    if isinstance(given, kind):
        return given
    if not isinstance(given, Mapping):
        raise ConfigError(
            f"{name} is {type(given).__name__}; give a {kind.__name__}, or a mapping of its options"
        )
    allowed = [field.name for field in dataclasses.fields(kind)]  # pyright: ignore[reportArgumentType]
    for key in given:
        if key not in allowed:
            raise ConfigError(f"{name} has no option '{key}'; {nearest_names(str(key), allowed)}")
    return kind(**given)


def check_function(name: str, value: Any) -> None:
    """Raises OptionError if what is called later cannot be called; None may be left out."""
    if value is not None and not callable(value):
        raise OptionError(f"'{name}' is {reprlib.repr(value)}; give a function", name)


def check_option(name: str, value: Any, least: float, most: float, *, whole: bool = True) -> None:
    """Checks a number that was given beside the settings, such as a count of frames.

    Raises:
      OptionError: If it is no number, or no whole one, or not from `least` to `most`.
    """
    kinds = numbers.Integral if whole else numbers.Real
    is_number = isinstance(value, kinds) and not isinstance(value, bool)
    if is_number and least <= value <= most:  # pyright: ignore[reportOperatorIssue]
        return
    shown = f"{value:g}" if isinstance(value, float) else reprlib.repr(value)
    kind = "whole number" if whole else "number"
    raise OptionError(f"'{name}' is {shown}; give a {kind} from {least:.12g} to {most:.12g}", name)


def check_fields(settings: Any, section: str) -> None:
    """Checks a dataclass of settings against its annotations and records.

    Args:
      settings: Dataclass whose fields are whole numbers, pairs of them, choices or others; the
        others are not looked at.

    Raises:
      ConfigError: For a choice that is not offered, or a count that is none; counts are positive
        unless their record says otherwise.
    """
    for field in dataclasses.fields(settings):
        value, kind = getattr(settings, field.name), _kinds(type(settings))[field.name]
        name, arguments = f"{section}.{field.name}", typing.get_args(kind)
        if typing.get_origin(kind) is typing.Literal and value not in arguments:
            raise ConfigError(f"{name} is {value!r}; allowed: {', '.join(map(str, arguments))}")
        record = field.metadata.get("setting")
        if record is None:
            continue
        if kind is int and not _is_count(value, 1 if record.least is None else record.least):
            sign = "positive " if record.least is None else ""
            raise ConfigError(f"{name} is {value!r}; it must be a {sign}whole number")
        is_pair = isinstance(value, tuple) and len(value) == 2 and all(map(_is_count, value))
        if arguments == (int, int) and not is_pair:
            raise ConfigError(f"{name} is {value!r}; it must be two positive whole numbers")
        if arguments and arguments[-1] is Ellipsis:
            _check_list(name, value, arguments[0])
        most = MAX_COUNTS.get(record.unit, math.inf) if record.most is None else record.most
        for count in value if isinstance(value, tuple) else (value,):
            if _is_count(count, 0):
                _check(name, count, 0, most, record.why)


def _check_list(name: str, values: Any, kind: type) -> None:
    """Names, or numbers from 0 on, in a tuple of any length."""
    if not isinstance(values, tuple) or len(values) > _MAX_LISTED:
        raise ConfigError(f"{name} must be a list of at most {_MAX_LISTED} entries: [a, b], or [a]")
    for value in values:
        if kind is str:
            fits = isinstance(value, str) and 0 < len(value) <= _MAX_CHARACTERS
            wanted = f"names of 1 to {_MAX_CHARACTERS} characters"
        else:
            fits, wanted = _is_count(value, 0), "numbers from 0 on"
        if not fits:
            raise ConfigError(f"{name} holds {reprlib.repr(value)}; it must be a list of {wanted}")


def _is_count(value: Any, least: int = 1) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and value >= least


@functools.cache
def _kinds(kind: type) -> dict[str, Any]:
    return typing.get_type_hints(kind)
