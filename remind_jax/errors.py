"""The one exception family of the package: what went wrong, what is allowed, what to do."""

from __future__ import annotations

import difflib
from collections.abc import Callable, Iterable


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


def first_line(error: BaseException) -> str:
    """What a library says about a failure, cut to one line; its type if it says nothing."""
    return (str(error).strip().splitlines() or [type(error).__name__])[0]
