"""Checks of settings that their type alone cannot make."""

from __future__ import annotations

import dataclasses
import functools
import typing
from collections.abc import Collection
from typing import Any

from remind_jax.errors import ConfigError


def check_fields(settings: Any, section: str, may_be_zero: Collection[str] = ()) -> None:
    """Checks a dataclass of settings against its annotations.

    Args:
      settings: Dataclass whose fields are whole numbers, pairs of them, choices or others; the
        others are not looked at.
      section: Its name in messages.
      may_be_zero: Names of whole numbers that may be 0; the rest must be positive.

    Raises:
      ConfigError: For a choice that is not offered, or a count that is none.
    """
    for name, kind in _kinds(type(settings)).items():
        value = getattr(settings, name)
        origin, arguments = typing.get_origin(kind), typing.get_args(kind)
        if origin is typing.Literal and value not in arguments:
            shown = ", ".join(map(str, arguments))
            raise ConfigError(f"{section}.{name} is {value!r}; allowed: {shown}")
        if kind is int and not _is_count(value, least=0 if name in may_be_zero else 1):
            sign = "" if name in may_be_zero else "positive "
            raise ConfigError(f"{section}.{name} is {value!r}; it must be a {sign}whole number")
        if arguments == (int, int) and not _are_two_counts(value):
            raise ConfigError(
                f"{section}.{name} is {value!r}; it must be two positive whole numbers"
            )


def _are_two_counts(value: Any) -> bool:
    return isinstance(value, tuple) and len(value) == 2 and all(map(_is_count, value))


def _is_count(value: Any, least: int = 1) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and value >= least


@functools.cache
def _kinds(kind: type) -> dict[str, Any]:
    hints = typing.get_type_hints(kind)
    return {field.name: hints[field.name] for field in dataclasses.fields(kind)}
