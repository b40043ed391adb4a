"""The one exception family of the package: what went wrong, what is allowed, what to do."""

from __future__ import annotations

import dataclasses
import difflib
import functools
import typing
from collections.abc import Callable, Collection, Iterable
from typing import Any


class RemindError(ValueError):
    """Something the caller can mend; its text is one sentence fit to be shown to a user."""


class SourceError(RemindError):
    """A video, folder, archive or mask file cannot be used."""


class ConfigError(RemindError):
    """A configuration key or value is not accepted."""


class OptionError(ConfigError):
    """An option has a value that makes no sense; its sentence names options in quotes.

    Args:
      sentence: What is wrong.
      *names: Options that are named in it.
    """

    def __init__(self, sentence: str, *names: str) -> None:
        super().__init__(sentence)
        self._names = names

    def spelled(self, spell: Callable[[str], str]) -> str:
        """The sentence with every option named as `spell` says, as the command line needs it."""
        sentence = str(self)
        for name in self._names:
            sentence = sentence.replace(f"'{name}'", spell(name))
        return sentence


class WeightsError(RemindError):
    """A weight file is missing, damaged or of another model."""


class SweepError(RemindError):
    """A sweep or a search over settings cannot be done as asked."""


class OutputError(RemindError):
    """A result cannot be written or read back."""


def close_names(name: str, allowed: Iterable[str]) -> list[str]:
    """At most three names that are much like a misspelt one, the closest first."""
    return difflib.get_close_matches(name, sorted(allowed), n=3, cutoff=0.6)


def nearest_names(name: str, allowed: Iterable[str]) -> str:
    """Half a sentence that helps with a misspelt name: the closest ones, else all of them."""
    names = sorted(allowed)
    close = close_names(name, names)
    if close:
        return "did you mean " + " or ".join(repr(c) for c in close) + "?"
    return "allowed: " + ", ".join(names)


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
