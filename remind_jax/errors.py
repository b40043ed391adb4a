"""The one exception family of the package: what went wrong, what is allowed, what to do."""

from __future__ import annotations

import difflib
import re
from collections.abc import Callable, Iterable

# Control characters but line breaks and tabs, those that turn the direction of writing, and what
# stands for bytes that are no text.
_COMMANDS = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\u202a-\u202e\u2066-\u2069\ud800-\udfff]")
_MOST_START, _MOST_END = 1200, 600  # characters of a sentence that are kept, if it is longer


class RemindError(ValueError):
    """Something the caller can mend; its text is one sentence fit to be shown to a user.

    Control characters in it, of names of files or classes, are written out; what is too long to be
    read is shortened.
    """

    def __init__(self, *parts: object) -> None:
        super().__init__(*(shortened(on_one_line(p)) if isinstance(p, str) else p for p in parts))


class SourceError(RemindError):
    """A video, folder, archive or mask file cannot be used."""


class UnreadableFrame(SourceError):
    """One frame or its masks cannot be read; the sequence goes on without it."""


class ConfigError(RemindError):
    """A configuration key or value is not accepted."""


class OptionError(ConfigError):
    """An option has a value that makes no sense; its sentence names options in quotes."""

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


def printable(text: str) -> str:
    r"""The text with what would command a terminal written out: `\x1b`, `\u202e`.

    Names of files, classes and archive members are somebody else's; line breaks and tabs of a
    message are ours, and stay.
    """
    return _COMMANDS.sub(lambda found: found[0].encode("unicode_escape").decode("ascii"), text)


def is_text(value: str) -> bool:
    """Whether a text can be written as UTF-8; bytes of names that are no text cannot."""
    return value.isascii() or not any("\ud800" <= letter <= "\udfff" for letter in value)


def as_text(value: str) -> str:
    r"""The text with bytes that are no text written out, as `\udcff` for the byte 0xff."""
    return value if is_text(value) else value.encode("utf-8", "backslashreplace").decode()


def on_one_line(text: str) -> str:
    """The text with all control characters written out, line breaks and tabs as well."""
    return printable(text).replace("\n", "\\n").replace("\t", "\\t")


def shortened(text: str) -> str:
    """The text, without its middle if it is too long to be read: values that are named may be."""
    if len(text) <= _MOST_START + _MOST_END:
        return text
    return f"{text[:_MOST_START]} [...] {text[-_MOST_END:]}"


def close_names(name: str, allowed: Iterable[str]) -> list[str]:
    """At most three names that are much like a misspelt one, the closest first."""
    return difflib.get_close_matches(name, sorted(allowed), n=3, cutoff=0.6)


def nearest_names(name: str, allowed: Iterable[str]) -> str:
    """Half a sentence that helps with a misspelt name: the closest ones, else all of them."""
    names = sorted(allowed)
    if not names:
        return "there are none"
    close = close_names(name, names)
    if close:
        return "did you mean " + " or ".join(repr(c) for c in close) + "?"
    return "allowed: " + ", ".join(names)


def first_line(error: BaseException) -> str:
    """What a library says about a failure, cut to one line; its type if it says nothing."""
    return (str(error).strip().splitlines() or [type(error).__name__])[0]
