"""Words of a command that make no sense, told in one sentence instead of the parser's boxes."""

from __future__ import annotations

import contextlib
import dataclasses
import reprlib
from collections.abc import Iterator
from typing import Any, get_args, get_type_hints

from remind_jax.cli.flags import UsageError, spell_flag
from remind_jax.errors import close_names
from remind_jax.printing.words import listing


@contextlib.contextmanager
def explained(verb: Any) -> Iterator[None]:
    """Refuses in one sentence what the parser refuses inside.

    The parser tells what was wrong to hooks that are no part of its stable interface. Where it has
    none, or finds something that is not known here, it prints a box of its own.

    Args:
      verb: Class of the verb; None if there is none.

    Raises:
      UsageError: If the words make no sense.
    """
    try:
        from tyro._errors import on_parse_error
    except ImportError:
        yield
        return

    def refuse(event: Any) -> None:
        sentence = ""
        # A field that another version lacks, or has otherwise.
        with contextlib.suppress(AttributeError, LookupError, TypeError):
            said = _explain(type(event).__name__, event, verb)
            sentence = said and f"{said} ('{event.prog} --help' shows what there is)"
        if sentence:
            raise UsageError(sentence)

    with on_parse_error(refuse):
        yield


def _explain(kind: str, event: Any, verb: Any) -> str:
    """What is wrong and what to do; nothing if the kind of event is unknown."""
    if kind == "MissingArgs" and not event.unrecognized_tokens:
        names = [_name(missing.arg) for missing in event.missing_arguments]
        return f"'{event.prog}' needs {listing(names)}; give {'it' if len(names) == 1 else 'them'}"
    if kind in ("MissingArgs", "UnrecognizedArgs"):
        words = event.tokens if kind == "UnrecognizedArgs" else event.unrecognized_tokens
        return _say_unknown(words[0], event.prog, verb)
    if kind == "MissingSubcommand":
        return f"nothing follows '{event.prog}'; give {listing(_parts(verb), 'or')}"
    if kind == "InvalidChoice":
        allowed = listing([repr(choice) for choice in event.choices], "or")
        return f"{_name(event.argument)} is {reprlib.repr(event.value)}; give {allowed}"
    if kind == "BadValue" and event.argument.is_positional():
        return f"'{event.prog}' needs {_name(event.argument)}; give it"
    if kind == "BadValue" and event.offending_value is None:
        return f"nothing follows {_name(event.argument)}; give its value"
    if kind == "InstantiationFailure":
        return f"{_name(event.argument)}: {event.message}"
    return ""


def _say_unknown(word: str, prog: str, verb: Any) -> str:
    shown, parts = reprlib.repr(word), _parts(verb)
    if word.startswith("-"):
        flag = word.partition("=")[0]
        close = close_names(flag, set(_flags(verb)))
        hint = f"did you mean {listing(close, 'or')}?" if close else "leave it out"
        return f"'{prog}' has no flag {shown}; {hint}"
    if parts:
        close = close_names(word, parts)
        hint = f"did you mean {listing(close, 'or')}?" if close else f"give {listing(parts, 'or')}"
        return f"'{prog}' has no {shown}; {hint}"
    return f"{shown} is a word too many; leave it out, or put words that belong together in quotes"


def _name(argument: Any) -> str:
    """As in help: a flag, or the word in capitals."""
    if argument.is_positional():
        return str(argument.lowered.metavar)
    return "/".join(argument.lowered.name_or_flags)


def _parts(verb: Any) -> list[str]:
    """Words that may follow a verb with parts, such as `config show`."""
    return [
        name
        for _, kind in _fields(verb)
        for part in get_args(kind)
        for name in _names_given(part)
        if _records(part)
    ]


def _flags(verb: Any) -> Iterator[str]:
    for record in _records(verb):
        for name, kind in _fields(record):
            if inner := _records(kind):
                for part in inner:
                    yield from _flags(part)
            else:
                yield spell_flag(name)


def _fields(record: Any) -> list[tuple[str, Any]]:
    """Names of the fields of a record, as flags are named, and their types."""
    if not dataclasses.is_dataclass(record):
        return []
    hints = get_type_hints(record, include_extras=True)
    found = []
    for field in dataclasses.fields(record):
        given = _names_given(hints[field.name])
        found.append((given[0] if given else field.name, hints[field.name]))
    return found


def _names_given(kind: Any) -> list[str]:
    """Names that the marks of a type give."""
    marks = getattr(kind, "__metadata__", ())
    return [name for mark in marks if (name := getattr(mark, "name", None))]


def _records(kind: Any) -> list[Any]:
    """Dataclasses in a type: itself, or those of a union."""
    if isinstance(kind, type):
        return [kind] if dataclasses.is_dataclass(kind) else []
    return [record for part in get_args(kind) for record in _records(part)]
