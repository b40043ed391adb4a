"""Structured text that enters: decoded into typed, bounded records, or refused in one sentence.

A record is a `msgspec.Struct` whose fields say what is allowed: use the bounded kinds below, since
a bare `int`, `str` or `list` has no bounds. Whatever is read is of limited size; numbers are finite
and integers have 64 bits. A refusal names file, place, what was found and what is allowed.
"""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Annotated, Any, Generic, NoReturn, TypeVar

import msgspec
from msgspec import Meta, inspect

from remind_jax.errors import RemindError, SourceError, first_line, is_text
from remind_jax.files import json_keys, reading
from remind_jax.files.json_keys import say_twice
from remind_jax.files.wording import place_in_words, say_invalid

MOST_LABEL = 200  # characters of a label
MOST_TEXT = 10_000  # characters of any other text
MOST_ROWS = 10_000_000
MOST_LINE_BYTES = 32 << 20
MOST_MAPPINGS = 4_000_000  # in a JSON file: as records these take up to about a gibibyte
MOST_ITEMS = 30_000_000  # in a JSON file, likewise
MOST_YAML_BYTES = 256 << 10  # a second or two
MOST_VALUES = 100_000  # in a mapping that came otherwise; aliases of YAML count as often as used
MOST_DEPTH = 32
MOST_INTEGER = 2**63 - 1

Whole = Annotated[int, Meta(ge=-(2**63), le=MOST_INTEGER)]
Small = Annotated[int, Meta(ge=-(2**31), le=2**31 - 1)]
Count = Annotated[int, Meta(ge=0, le=2**31 - 1)]
Positive = Annotated[int, Meta(ge=1, le=2**31 - 1)]
Share = Annotated[float, Meta(ge=0.0, le=1.0)]
Side = Annotated[int, Meta(ge=1, le=1 << 16)]  # of a picture, pixels
Label = Annotated[str, Meta(max_length=MOST_LABEL)]
Text = Annotated[str, Meta(max_length=MOST_TEXT)]

Record = TypeVar("Record")
Family = type[RemindError]


@dataclasses.dataclass(frozen=True)
class Row(Generic[Record]):
    """One of many entries of a file: a record, or why it is none."""

    number: int  # from 1
    record: Record | None
    error: RemindError | None = None

    def get(self) -> Record:
        """The record.

        Raises:
          RemindError: If it is none.
        """
        if self.error is not None:
            raise self.error
        return self.record  # pyright: ignore[reportReturnType]


def read_json(
    path: str | Path,
    record: type[Record],
    *,
    refused: Family = SourceError,
    most_bytes: int = reading.MOST_BYTES,
) -> Record:
    """Reads a JSON file.

    Args:
      path: The file.
      record: What it holds, bounded.
      refused: Kind of error.
      most_bytes: Larger files are not read.

    Raises:
      RemindError: Of kind `refused`, if it cannot be read or holds something else.
    """
    return decode_json(_read(path, refused, most_bytes), record, f"'{path}'", refused=refused)


def decode_json(
    data: bytes, record: type[Record], where: str, *, refused: Family = SourceError
) -> Record:
    """Reads JSON that was read from `where`, such as a quoted path; see `read_json`.

    Raises:
      RemindError: Of kind `refused`, if it holds something else.
    """
    if wrong := reading.wrong_encoding(data):
        raise refused(f"{where}: {wrong}")
    data = data.removeprefix(b"\xef\xbb\xbf")
    if len(data) > MOST_MAPPINGS:  # shorter text cannot hold more
        for what, mark, most in (("mappings", b"{", MOST_MAPPINGS), ("items", b",", MOST_ITEMS)):
            if data.count(mark) > most:
                raise refused(f"{where} holds over {most} {what}, which are not read; split it")
    try:
        decoded = _decoder(record).decode(data)
    except (msgspec.DecodeError, RecursionError) as error:
        _refuse(say_invalid(data, error, record), where, refused, error)
    # What is decoded later is looked through then, so that a bad row spoils no other.
    if said := say_twice(data, is_shallow=_holds_undecoded(record)):
        raise refused(f"{where}{said}")
    return decoded


def decode_rows(
    raws: Iterable[msgspec.Raw],
    record: type[Record],
    where: str,
    *,
    refused: Family = SourceError,
) -> Iterator[Row[Record]]:
    """Entries of a list one by one, so that a bad one spoils no other.

    Args:
      raws: The list as it was decoded, of type `list[msgspec.Raw]`.
      record: What each entry is.
      where: Place of the list, such as a quoted path.
      refused: Kind of error.

    Yields:
      Every entry, bad ones with their error.
    """
    decode, num_bytes = _decoder(record).decode, 0
    for number, raw in enumerate(raws, 1):
        data = bytes(raw)
        num_bytes += len(data)
        try:
            decoded, said = decode(raw), ""
            if num_bytes <= json_keys.MOST_BYTES:
                said = say_twice(data, is_shallow=_holds_undecoded(record))
        except (msgspec.DecodeError, RecursionError) as error:
            decoded, said = None, say_invalid(data, error, record)
        if said:
            yield Row(number, None, refused(f"{where}, row {number}{said}"))
        else:
            yield Row(number, decoded)


def read_json_lines(
    path: str | Path,
    record: type[Record],
    *,
    refused: Family = SourceError,
    skip: int = 0,
) -> Iterator[Row[Record]]:
    """Reads JSON values of a file line by line; empty lines are left out.

    Args:
      path: The file.
      record: What each line holds.
      refused: Kind of error.
      skip: Lines at the start that are left out.

    Yields:
      Every line, bad ones with their error.

    Raises:
      RemindError: Of kind `refused`, if the file cannot be read, or a line or their number is
        beyond all measure.
    """
    decode, where, num_bytes = _decoder(record).decode, f"'{path}'", 0
    for number, line in read_lines(path, refused=refused):
        if number <= skip:
            continue
        num_bytes += len(line)
        try:
            decoded, said = decode(line), ""
            if num_bytes <= json_keys.MOST_BYTES:
                said = say_twice(line)
        except (msgspec.DecodeError, RecursionError, UnicodeDecodeError) as error:
            wrong = reading.wrong_encoding(line)
            decoded, said = None, f": {wrong}" if wrong else say_invalid(line, error, record)
        if said:
            yield Row(number, None, refused(f"{where}, row {number}{said}"))
        else:
            yield Row(number, decoded)


def read_lines(path: str | Path, *, refused: Family = SourceError) -> Iterator[tuple[int, bytes]]:
    """Number and bytes of every line that is not empty, read one at a time.

    Raises:
      RemindError: Of kind `refused`, if the file cannot be read, is no text in UTF-8, or a line or
        their number is beyond all measure.
    """
    try:
        reading.check_regular(path)
        with Path(path).open("rb") as file:
            start = file.peek(4)[:4]
            if start[:2] in (b"\xff\xfe", b"\xfe\xff") or b"\x00" in start:
                raise refused(f"'{path}': {reading.wrong_encoding(start)}")
            number = 0
            while line := file.readline(MOST_LINE_BYTES + 1):
                number += 1
                if len(line) > MOST_LINE_BYTES or number > MOST_ROWS:
                    most = f"{reading.say_bytes(MOST_LINE_BYTES)} in a line, {MOST_ROWS} lines"
                    raise refused(f"'{path}', row {number}: at most {most} are read; split it")
                if number == 1:
                    line = line.removeprefix(b"\xef\xbb\xbf")
                if line.strip():
                    yield number, line
    except OSError as error:
        raise refused(f"cannot read '{path}': {error.strerror or first_line(error)}") from error


def read_yaml(
    path: str | Path, record: type[Record] | Any, *, refused: Family = SourceError
) -> Record:
    """Reads a YAML file; an empty one is an empty mapping.

    Args:
      path: The file.
      record: What it holds; `dict[str, Any]` for any mapping.
      refused: Kind of error.

    Raises:
      RemindError: Of kind `refused`, if it cannot be read, is no YAML, names a key twice, or holds
        something else.
    """
    from remind_jax.files.yaml_text import parse_yaml

    data = _read(path, refused, MOST_YAML_BYTES)
    if wrong := reading.wrong_encoding(data):
        raise refused(f"'{path}': {wrong}")
    value = parse_yaml(data.decode("utf-8-sig"), f"'{path}'", refused)
    return check({} if value is None else value, record, f"'{path}'", refused=refused)


def check(
    value: Any, record: type[Record] | Any, where: str, *, refused: Family = SourceError
) -> Record:
    """Turns nested mappings and lists that came otherwise (Python, YAML) into a record.

    Args:
      value: Of plain kinds: mappings with text as keys, lists, tuples, text, numbers, None.
      record: What it must be.
      where: Where it is from, in messages.
      refused: Kind of error.

    Raises:
      RemindError: Of kind `refused`, if it is something else, nested too deep or too large, or a
        number in it is not finite or has over 64 bits.
    """
    _check_values(value, where, refused)
    try:
        return msgspec.convert(value, record)
    except msgspec.ValidationError as error:
        _refuse(say_invalid(value, error, record), where, refused, error)


def _read(path: str | Path, refused: Family, most_bytes: int) -> bytes:
    try:
        return reading.read_bytes(path, most_bytes)
    except OSError as error:
        raise refused(f"cannot read '{path}': {error.strerror or first_line(error)}") from error


def _refuse(said: str, where: str, refused: Family, error: Exception) -> NoReturn:
    raise refused(f"{where}{said}") from error


@functools.cache
def _holds_undecoded(record: Any) -> bool:
    """Whether a type leaves parts of the text as they are, to be decoded one by one."""
    return "RawType()" in repr(inspect.type_info(record))


@functools.cache
def _decoder(record: Any) -> msgspec.json.Decoder:
    return msgspec.json.Decoder(record)


def _say_number(path: str) -> str:
    return place_in_words(path, is_number=True)


def _check_values(value: Any, where: str, refused: Family) -> None:
    """Walks through nested values; what is used several times counts as often."""
    open_values: list[tuple[str, int, Any]] = [("$", 1, value)]
    num_values = 0
    while open_values:
        place, depth, found = open_values.pop()
        num_values += 1
        if depth > MOST_DEPTH or num_values > MOST_VALUES:
            most = f"{MOST_VALUES} values, nested {MOST_DEPTH} deep"
            raise refused(f"{where}{place_in_words(place)}: it holds too much; at most {most}")
        if isinstance(found, dict):
            open_values += [(f"{place}.{key}", depth + 1, part) for key, part in found.items()]
        elif isinstance(found, (list, tuple)):
            open_values += [(f"{place}[{i}]", depth + 1, part) for i, part in enumerate(found)]
        elif isinstance(found, str) and not is_text(found):
            raise refused(
                f"{where}{place_in_words(place)}: found {found[:40]!r}, which is no text in UTF-8; "
                "correct it"
            )
        elif isinstance(found, float) and not math.isfinite(found):
            raise refused(f"{where}{_say_number(place)}: found {found}, give a finite number")
        elif isinstance(found, int) and abs(found) > MOST_INTEGER:
            raise refused(
                f"{where}{_say_number(place)}: found an integer of {len(hex(found)) * 4 - 8} "
                "bits, at most 64 are allowed; correct it"
            )
