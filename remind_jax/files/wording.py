"""What is wrong with structured text, in our words: place, what was found, what is allowed."""

from __future__ import annotations

import json
import re
from typing import Any

import msgspec
from msgspec import inspect

from remind_jax.errors import close_names

_SMALL_BYTES = 16 << 20  # up to here a refused text is decoded again, to show what was found
_MOST_SHOWN = 40  # characters of a value
_MOST_SAID = 100_000  # longer limits of lists are not mentioned
_PATH = re.compile(r" - at (?:`key` in )?`(\$[^`]*)`$")
_STEP = re.compile(r"\.([^.\[]+)|\[(\d+|\.\.\.)\]")
_MISSING = re.compile(r"^Object missing required field `([^`]*)`")
_UNKNOWN = re.compile(r"^Object contains unknown field `([^`]*)`")
_BYTE = re.compile(r"\(byte (\d+)\)")
_NOT_FINITE = re.compile(rb'"(?:[^"\\]|\\.)*"|(-?Infinity|NaN)')
_MARK = "not a finite number"
_UNSEEN = object()


def say_invalid(content: Any, error: Exception, record: Any) -> str:
    """The rest of a sentence that begins with the name of a file.

    Args:
      content: What was refused: bytes of JSON, or nested values.
      error: What `msgspec` said of it.
      record: The type that it should have had.
    """
    if isinstance(error, RecursionError):
        return ": it is nested too deep; correct it"
    if isinstance(content, bytes) and not isinstance(error, msgspec.ValidationError):
        named = _NOT_FINITE.sub(_name_number, content)
        if named == content:
            return _say_malformed(content, str(error))
        try:
            msgspec.json.decode(named, type=record)
        except msgspec.ValidationError as sharper:
            content, error = named, sharper
        except (msgspec.DecodeError, RecursionError):
            return _say_malformed(content, str(error))
        else:
            return ": it holds NaN or Infinity, which are no JSON; write null instead"
    return _say_invalid(content, str(error), record)


def place_in_words(path: str, *, is_number: bool = False) -> str:
    """A path such as `$[16].a.b` in words: ", row 17, `a.b`".

    Args:
      path: As `msgspec` writes it.
      is_number: Whether what stands there is one of many values of a row: `$.bbox[2]` then is
        ", `bbox`, number 3".
    """
    parts, names = [], ""
    steps = _STEP.findall(path)
    for place, (name, index) in enumerate(steps):
        if name:
            names += f".{name}" if names else name
            continue
        if index == "...":
            continue
        is_within = is_number and place > 0 and not any(name for name, _ in steps[place:])
        if not is_within and any(part.startswith("row ") for part in parts):
            names += f"[{index}]"
            continue
        word = "row" if not is_within else "part" if steps[place + 1 :] else "number"
        parts += [f"`{_cut(names)}`"] if names else []
        parts.append(f"{word} {int(index) + 1}")
        names = ""
    parts += [f"`{_cut(names)}`"] if names else []
    return "".join(f", {part}" for part in parts)


def show(value: Any) -> str:
    """A value as JSON, cut to a few characters."""
    if isinstance(value, dict) and list(value) == [_MARK]:
        return str(value[_MARK])
    if isinstance(value, (dict, list, tuple)):
        kind = "a mapping" if isinstance(value, dict) else "a list"
        return f"{kind} of {len(value)}"
    if isinstance(value, str):
        return _cut(json.dumps(value))
    if isinstance(value, int) and not isinstance(value, bool) and abs(value) >= 1 << 64:
        return "an integer of over 64 bits"
    return _cut(json.dumps(value) if value is None or isinstance(value, bool) else repr(value))


def _say_malformed(data: bytes, said: str) -> str:
    """What is wrong with text that is no JSON."""
    if not data.strip():
        return ": it is empty, JSON was expected"
    if "truncated" in said:
        return ": its JSON is cut short or damaged; make it again"
    found = _BYTE.search(said)
    place = ""
    if found:
        byte = int(found[1])
        line = data.count(b"\n", 0, byte) + 1
        column = byte - data.rfind(b"\n", 0, byte)
        place = f" (line {line}, column {column})" if line > 1 else f" (column {column})"
    reason = said.partition(": ")[2].partition(" (byte")[0] or said
    return f": it is not valid JSON, {reason}{place}; correct it"


def _say_invalid(content: Any, said: str, record: Any) -> str:
    match = _PATH.search(said)
    on_key = " - at `key` in" in said
    path, said = (match[1], said[: match.start()]) if match else ("$", said)
    steps = _STEP.findall(path)
    kinds = _kinds_at(inspect.type_info(record), steps)
    holders = (inspect.StructType, inspect.DictType)
    place = place_in_words(path, is_number=not any(isinstance(kind, holders) for kind in kinds))
    if missing := _MISSING.match(said):
        return f"{place}: `{missing[1]}` is missing; add it"
    if unknown := _UNKNOWN.match(said):
        names = [
            f.encode_name for k in kinds if isinstance(k, inspect.StructType) for f in k.fields
        ]
        close = close_names(unknown[1], names)
        hint = f"did you mean {' or '.join(map(repr, close))}?" if close else "remove it"
        return f"{place}: there is no field {show(unknown[1])}; {hint}"
    if on_key:
        return f"{place}: {said[:1].lower()}{said[1:]} as a key; rename it"
    found = _value_at(content, steps)
    shown = f"{said[:1].lower()}{said[1:]}" if found is _UNSEEN else f"found {show(found)}"
    allowed = " or ".join(dict.fromkeys(map(_say_kind, _join_literals(kinds))))
    wanted = f", allowed is {allowed}" if allowed else f" ({said.lower()})"
    return f"{place}: {shown}{wanted}; correct or remove it"


def _name_number(match: re.Match[bytes]) -> bytes:
    """A number that JSON does not know, as a mapping that no record allows in its place."""
    token = match[1]
    return match[0] if token is None else b'{"%b":"%b"}' % (_MARK.encode(), token)


def _kinds_at(kind: inspect.Type, steps: list[tuple[str, str]]) -> list[inspect.Type]:
    """Types that a value may have at a place; of unions, those that have such a place."""
    if isinstance(kind, inspect.Metadata):
        return _kinds_at(kind.type, steps)
    if isinstance(kind, inspect.UnionType):
        return [found for part in kind.types for found in _kinds_at(part, steps)]
    if not steps:
        return [kind]
    (name, index), rest = steps[0], steps[1:]
    below: inspect.Type | None = None
    if name and isinstance(kind, inspect.StructType) and name == kind.tag_field:
        below = inspect.LiteralType((kind.tag,))
    elif name and isinstance(kind, inspect.StructType):
        below = next((f.type for f in kind.fields if f.encode_name == name), None)
    elif index and isinstance(kind, inspect.DictType):
        below = kind.value_type
    elif index and isinstance(kind, inspect.TupleType) and index != "...":
        below = kind.item_types[int(index)]
    elif index and isinstance(kind, (inspect.ListType, inspect.VarTupleType)):
        below = kind.item_type
    return [] if below is None else _kinds_at(below, rest)


def _join_literals(kinds: list[inspect.Type]) -> list[inspect.Type]:
    """Kinds of which those that are values are one."""
    values = [v for kind in kinds if isinstance(kind, inspect.LiteralType) for v in kind.values]
    rest = [kind for kind in kinds if not isinstance(kind, inspect.LiteralType)]
    return [inspect.LiteralType(tuple(values)), *rest] if values else rest


def _value_at(content: Any, steps: list[tuple[str, str]]) -> Any:
    """What stands at a place; `_UNSEEN` if that cannot be told."""
    if isinstance(content, bytes):
        if len(content) > _SMALL_BYTES:
            return _UNSEEN
        try:
            content = msgspec.json.decode(content)
        except (msgspec.DecodeError, RecursionError):
            return _UNSEEN
    for name, index in steps:
        if index == "...":
            return _UNSEEN
        content = content[name] if name else content[int(index)]
    return content


def _say_kind(kind: inspect.Type) -> str:
    """What a type allows."""
    if isinstance(kind, (inspect.IntType, inspect.FloatType)):
        noun = "an integer" if isinstance(kind, inspect.IntType) else "a finite number"
        return noun + _say_range(kind.ge, kind.le, kind.gt, kind.lt)
    if isinstance(kind, inspect.StrType):
        most = f" of at most {kind.max_length} characters" if kind.max_length else ""
        least = "text" if not kind.min_length else "text that is not empty"
        return least + most
    if isinstance(kind, inspect.LiteralType):
        return "one of " + ", ".join(json.dumps(value) for value in kind.values)
    if isinstance(kind, inspect.TupleType):
        return f"a list of {len(kind.item_types)}"
    if isinstance(kind, (inspect.ListType, inspect.VarTupleType)):
        most = kind.max_length if (kind.max_length or 0) < _MOST_SAID else None
        return "a list" + _say_range(kind.min_length, most, noun=" in length")
    if isinstance(kind, (inspect.StructType, inspect.DictType)):
        return "a mapping"
    names = {inspect.BoolType: "true or false", inspect.NoneType: "null"}
    return names.get(type(kind), "another kind of value")


def _say_range(
    least: float | None, most: float | None, above: Any = None, below: Any = None, noun: str = ""
) -> str:
    if least is not None and most is not None and (least, most) != (-(2**63), 2**63 - 1):
        return f" from {_number(least)} to {_number(most)}{noun}"
    if least == -(2**63):
        return " of 64 bits"
    parts = ((least, "of at least"), (most, "of at most"), (above, "above"), (below, "below"))
    return "".join(f" {words} {_number(b)}{noun}" for b, words in parts if b is not None)


def _number(bound: float) -> str:
    return str(bound) if isinstance(bound, int) else f"{bound:g}"


def _cut(text: str) -> str:
    return text if len(text) <= _MOST_SHOWN else f"{text[: _MOST_SHOWN - 3]}..."
