"""Whether values of settings are allowed."""

from __future__ import annotations

import dataclasses
import functools
import reprlib
import typing
from typing import Any

from remind_jax.errors import ConfigError
from remind_jax.settings.ranges import check_count

_MOST_LISTED = 10_000
_MOST_CHARACTERS = 200  # of a name


def check_fields(settings: Any, section: str) -> None:
    """Checks a dataclass of settings against its annotations and records.

    Args:
      settings: Dataclass whose fields are whole numbers, pairs of them, choices or others; the
        others are not looked at.
      section: Its name in messages.

    Raises:
      ConfigError: For a choice that is not offered, or a count that is none; counts are positive
        unless their record says otherwise.
    """
    for field in dataclasses.fields(settings):
        value, kind = getattr(settings, field.name), _kinds(type(settings))[field.name]
        name, arguments = f"{section}.{field.name}", typing.get_args(kind)
        if typing.get_origin(kind) is typing.Literal and value not in arguments:
            raise ConfigError(f"{name} is {value!r}; allowed: {', '.join(map(str, arguments))}")
        record = field.metadata["setting"]
        if kind is int and not _is_count(value, 1 if record.least is None else record.least):
            sign = "positive " if record.least is None else ""
            raise ConfigError(f"{name} is {value!r}; it must be a {sign}whole number")
        if arguments == (int, int) and not _are_two_counts(value):
            raise ConfigError(f"{name} is {value!r}; it must be two positive whole numbers")
        if arguments and arguments[-1] is Ellipsis:
            _check_list(name, value, arguments[0])
        for count in value if isinstance(value, tuple) else (value,):
            check_count(name, count, record)


def _check_list(name: str, values: Any, kind: type) -> None:
    """Names, or numbers from 0 on, in a tuple of any length."""
    is_one = _is_name if kind is str else lambda value: _is_count(value, 0)
    if not isinstance(values, tuple) or len(values) > _MOST_LISTED:
        raise ConfigError(f"{name} must be a list of at most {_MOST_LISTED} entries")
    for value in values:
        if not is_one(value):
            names = f"names of 1 to {_MOST_CHARACTERS} characters"
            what = names if kind is str else "numbers from 0 on"
            raise ConfigError(f"{name} holds {reprlib.repr(value)}; it must be a list of {what}")


def _is_name(value: Any) -> bool:
    return isinstance(value, str) and 0 < len(value) <= _MOST_CHARACTERS


def _are_two_counts(value: Any) -> bool:
    return isinstance(value, tuple) and len(value) == 2 and all(map(_is_count, value))


def _is_count(value: Any, least: int = 1) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and value >= least


@functools.cache
def _kinds(kind: type) -> dict[str, Any]:
    return typing.get_type_hints(kind)
