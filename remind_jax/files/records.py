"""Structured text that enters: decoded into typed, bounded records, or refused in one sentence.

Use the bounded kinds below: a bare `int`, `str` or `list` has no bounds.
"""

from __future__ import annotations

import dataclasses
import functools
import json
import math
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Annotated, Any, Generic, TypeVar

import msgspec
from msgspec import Meta

from remind_jax.errors import RemindError, SourceError, first_line, is_text
from remind_jax.files import limits
from remind_jax.files.reading import (
    Family,
    check_regular,
    read_bytes,
    reading,
    say_bytes,
    wrong_encoding,
)

Whole = Annotated[int, Meta(ge=-(2**63), le=limits.MAX_INTEGER)]
Small = Annotated[int, Meta(ge=-(2**31), le=2**31 - 1)]
Count = Annotated[int, Meta(ge=0, le=2**31 - 1)]
Positive = Annotated[int, Meta(ge=1, le=2**31 - 1)]
Share = Annotated[float, Meta(ge=0.0, le=1.0)]
Side = Annotated[int, Meta(ge=1, le=limits.MAX_SIDE_PX)]  # of a picture, pixels
Label = Annotated[str, Meta(max_length=limits.MAX_LABEL)]
Text = Annotated[str, Meta(max_length=limits.MAX_TEXT)]

Record = TypeVar("Record")


@dataclasses.dataclass(frozen=True)
class Row(Generic[Record]):
    """One of many entries of a file: a record, or why it is none."""

    number: int  # from 1
    record: Record | None
    error: RemindError | None = None

    def get(self) -> Record:
        """The record. Raises RemindError if it is none."""
        if self.error is not None:
            raise self.error
        return self.record  # pyright: ignore[reportReturnType]


def read_json(
    path: str | Path,
    record: type[Record],
    *,
    refused: Family = SourceError,
    max_bytes: int = limits.MAX_FILE_BYTES,
) -> Record:
    """Reads a JSON file.

    Raises:
      RemindError: Of kind `refused`, if it cannot be read or holds something else.
    """
    with reading(path, refused):
        data = read_bytes(path, max_bytes)
    return decode_json(data, record, f"'{path}'", refused=refused)


def decode_json(
    data: bytes, record: type[Record], where: str, *, refused: Family = SourceError
) -> Record:
    """Reads JSON that was read from `where`, such as a quoted path; see `read_json`.

    Raises:
      RemindError: Of kind `refused`, if it holds something else.
    """
    if wrong := wrong_encoding(data):
        raise refused(f"{where}: {wrong}")
    data = data.removeprefix(b"\xef\xbb\xbf")
    marks = (("mappings", b"{", limits.MAX_MAPPINGS), ("items", b",", limits.MAX_ITEMS))
    for what, mark, most in marks:
        if len(data) > most and data.count(mark) > most:
            raise refused(f"{where} holds over {most} {what}, which are not read; split it")
    row = _decode(_decoder(record).decode, data, f"{where}: ", 0, refused)
    # What is decoded later is looked through then, so that a bad row spoils no other.
    if row.error is None and not _holds_undecoded(record) and (twice := _key_twice(data)):
        raise refused(f"{where}: {twice}")
    return row.get()


def decode_rows(
    raws: Iterable[msgspec.Raw], record: type[Record], where: str
) -> Iterator[Row[Record]]:
    """Entries of a list one by one, so that a bad one spoils no other.

    Yields:
      Every entry, bad ones with their error.
    """
    decode = _decoder(record).decode
    for number, raw in enumerate(raws, 1):
        yield _decode(decode, raw, f"{where}, row {number}: ", number, SourceError)


def read_lines(path: str | Path, *, refused: Family = SourceError) -> Iterator[tuple[int, bytes]]:
    """Number and bytes of every line that is not empty, read one at a time.

    Raises:
      RemindError: Of kind `refused`, if the file cannot be read, is no text in UTF-8, or a line or
        their number is beyond all measure.
    """
    with reading(path, refused):
        check_regular(path)
        file = Path(path).open("rb")  # noqa: SIM115
    with file:
        start = file.peek(4)[:4]
        if start[:2] in (b"\xff\xfe", b"\xfe\xff") or b"\x00" in start:
            raise refused(f"'{path}': {wrong_encoding(start)}")
        number = 0
        while True:
            with reading(path, refused):
                line = file.readline(limits.MAX_LINE_BYTES + 1)
            if not line:
                return
            number += 1
            if len(line) > limits.MAX_LINE_BYTES or number > limits.MAX_ROWS:
                most = f"{say_bytes(limits.MAX_LINE_BYTES)} in a line, {limits.MAX_ROWS} lines"
                raise refused(f"'{path}', row {number}: at most {most} are read; split it")
            if number == 1:
                line = line.removeprefix(b"\xef\xbb\xbf")
            if line.strip():
                yield number, line


def read_yaml(
    path: str | Path, record: type[Record] | Any, *, refused: Family = SourceError
) -> Record:
    """Reads a YAML file; an empty one is an empty mapping.

    Raises:
      RemindError: Of kind `refused`, if it cannot be read, is no YAML, names a key twice, or holds
        something else.
    """
    from remind_jax.files.yaml_text import parse_yaml

    with reading(path, refused):
        data = read_bytes(path, limits.MAX_YAML_BYTES)
    if wrong := wrong_encoding(data):
        raise refused(f"'{path}': {wrong}")
    value = parse_yaml(data.decode("utf-8-sig"), f"'{path}'", refused)
    return check({} if value is None else value, record, f"'{path}'", refused=refused)


def check(
    value: Any, record: type[Record] | Any, where: str, *, refused: Family = SourceError
) -> Record:
    """Turns nested mappings and lists that came otherwise (Python, YAML) into a record.

    Args:
      value: Of plain kinds: mappings with text as keys, lists, tuples, text, numbers, None.

    Raises:
      RemindError: Of kind `refused`, if it is something else, nested too deep or too large, or a
        number in it is not finite or has over 64 bits.
    """
    _check_values(value, where, refused)
    try:
        return msgspec.convert(value, record)
    except msgspec.ValidationError as error:
        raise refused(f"{where}: {_said(error)}; correct it") from error


def _decode(
    decode: Callable[[Any], Any], data: Any, where: str, number: int, refused: Family
) -> Row[Any]:
    """Decodes one text; of a row with a number, keys that stand twice are found as well."""
    try:
        decoded = decode(data)
        said = _key_twice(bytes(data)) if number else ""
    except (msgspec.DecodeError, RecursionError, UnicodeDecodeError) as error:
        decoded, said = None, wrong_encoding(bytes(data)) or f"{_said(error)}; correct it"
    return Row(number, None, refused(where + said)) if said else Row(number, decoded)


def _said(error: Exception) -> str:
    return "it is nested too deep" if isinstance(error, RecursionError) else first_line(error)


def _key_twice(data: bytes) -> str:
    """Half a sentence on a key that stands twice: `msgspec` keeps the last of them without a word.

    Nothing if none does, or the text is large.
    """
    if data.count(b":") < 2 or len(data) > limits.MAX_UNIQUE_BYTES:
        return ""
    twice: list[str] = []

    def look(pairs: list[tuple[str, Any]]) -> None:
        if len({key for key, _ in pairs}) < len(pairs):
            keys = [key for key, _ in pairs]
            twice.append(next(key for key in keys if keys.count(key) > 1))

    try:
        json.loads(data, object_pairs_hook=look)
    except (ValueError, RecursionError):
        return ""
    return f"the key {json.dumps(twice[0][:100])} stands twice; remove one" if twice else ""


@functools.cache
def _holds_undecoded(record: Any) -> bool:
    """Whether a type leaves rows of a list as they are, to be decoded one by one."""
    return "ListType(item_type=RawType()" in repr(msgspec.inspect.type_info(record))


@functools.cache
def _decoder(record: Any) -> msgspec.json.Decoder:
    return msgspec.json.Decoder(record)


def _check_values(value: Any, where: str, refused: Family) -> None:
    """Walks through nested values; what is used several times counts as often."""
    open_values: list[tuple[str, int, Any]] = [("", 1, value)]
    num_values = 0
    while open_values:
        place, depth, found = open_values.pop()
        num_values += 1
        said = ""
        if depth > limits.MAX_DEPTH or num_values > limits.MAX_VALUES:
            most = f"{limits.MAX_VALUES} values, nested {limits.MAX_DEPTH} deep"
            said = f"it holds too much; at most {most}"
        elif isinstance(found, dict):
            open_values += [
                (f"{place}.{key}" if place else str(key), depth + 1, part)
                for key, part in found.items()
            ]
        elif isinstance(found, (list, tuple)):
            open_values += [(f"{place}[{i}]", depth + 1, part) for i, part in enumerate(found)]
        elif isinstance(found, str) and not is_text(found):
            said = f"found {found[:40]!r}, which is no text in UTF-8; correct it"
        elif isinstance(found, float) and not math.isfinite(found):
            said = f"found {found}, give a finite number"
        elif isinstance(found, int) and abs(found) > limits.MAX_INTEGER:
            said = f"found an integer of {found.bit_length()} bits, at most 64 are allowed"
        if said:
            raise refused(f"{where}{place and f', `{place[:100]}`'}: {said}")
