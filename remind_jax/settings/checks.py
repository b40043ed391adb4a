"""Whether values of settings are allowed."""

from __future__ import annotations

import dataclasses
import functools
import typing
from typing import Any

from remind_jax.errors import ConfigError
from remind_jax.settings.record import Setting


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
        least = field.metadata["setting"].least
        if kind is int and not _is_count(value, 1 if least is None else least):
            sign = "positive " if least is None else ""
            raise ConfigError(f"{name} is {value!r}; it must be a {sign}whole number")
        if kind is int:
            check_most(name, value, field.metadata["setting"])
        if arguments == (int, int) and not _are_two_counts(value):
            raise ConfigError(f"{name} is {value!r}; it must be two positive whole numbers")


def check_most(name: str, value: Any, record: Setting) -> None:
    """Checks a number against the largest that is supported.

    Raises:
      ConfigError: If it is larger.
    """
    if record.most is not None and isinstance(value, (int, float)) and value > record.most:
        raise ConfigError(f"{name} is {value!r}; supported: up to {record.most}, {record.why}")


def _are_two_counts(value: Any) -> bool:
    return isinstance(value, tuple) and len(value) == 2 and all(map(_is_count, value))


def _is_count(value: Any, least: int = 1) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and value >= least


@functools.cache
def _kinds(kind: type) -> dict[str, Any]:
    return typing.get_type_hints(kind)
