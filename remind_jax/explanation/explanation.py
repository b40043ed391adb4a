"""Why one detection became what it became, as far as this is the same for every method."""

from __future__ import annotations

import abc
import dataclasses
import enum
import functools
import textwrap
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, ClassVar, TypeVar, get_type_hints

import numpy as np

from remind_jax.decision import NO_ID, Outcome, Reason
from remind_jax.printing.small_table import align
from remind_jax.printing.terminal import split_columns
from remind_jax.printing.words import number
from remind_jax.tracks import Tracks

Read = TypeVar("Read")
_MAX_WIDTH = 100  # columns of running text


@dataclasses.dataclass(frozen=True)
class Section:
    """What a decision was made of, in part: sentences, and a table if there are rows."""

    title: str
    lines: tuple[str, ...] = ()
    heads: tuple[str, ...] = ()
    rows: tuple[tuple[str, ...], ...] = ()
    is_text: tuple[int, ...] = (0,)  # columns that are flush left

    def to_lines(self, width: int | None) -> list[str]:
        """The same as plain text."""
        lines = [line for text in (self.title, *self.lines) for line in wrap(text, width)]
        table = (self.heads, *self.rows)
        return lines + (lay_out(table, self.is_text, width) if self.rows else [])


@dataclasses.dataclass(frozen=True, kw_only=True)
class Explanation(abc.ABC):
    """Why one detection became what it became; methods add what they decide by."""

    FORMAT: ClassVar[str]
    VERSION: ClassVar[int] = 1

    frame: int
    time_s: float
    frame_name: str
    detection: int
    label: str
    name: str  # `mug 4`, `mug 3 or 7?`
    outcome: Outcome
    reason: Reason
    object_id: int | None
    decided_at: int | None  # frame in which its object was decided on; None if in none of the run
    confidence: float | None  # None where it is left out
    why: tuple[str, ...]  # sentences, in the order in which it was decided

    def to_json(self) -> dict[str, Any]:
        """The same as `json` can write it."""
        return {"format": self.FORMAT, "version": self.VERSION} | to_jsonable(self)

    def to_text(self, width: int | None = None) -> str:
        """The same as a page of plain text, without a line end at its end."""
        why = [
            line
            for place, text in enumerate(self.why, start=1)
            for line in wrap(text, width, head=f"{place:3d}. ", indent=5)
        ]
        sections = (
            self._headline(width),
            ["why", *why],
            *(section.to_lines(width) for section in self.sections()),
        )
        return "\n\n".join("\n".join(lines) for lines in sections)

    def __str__(self) -> str:
        return self.to_text()

    def _numbers(self) -> dict[str, float | None]:
        """What is said beside the outcome, by name."""
        return {"confidence": self.confidence}

    @abc.abstractmethod
    def sections(self) -> Iterator[Section]:
        """What stands below the reasons."""

    def _headline(self, width: int | None) -> list[str]:
        """What is explained and what it became, with those of the numbers that there are."""
        place = f"frame {self.frame} ({self.time_s:.2f} s, {self.frame_name})"
        numbers = [f"{name} {number(n)}" for name, n in self._numbers().items() if n is not None]
        became = ", ".join([f"{say_code(self.outcome)} ({say_code(self.reason)})", *numbers])
        return [
            *wrap(f"{place}, detection {self.detection}: {self.name}", width),
            *wrap(became, width),
        ]


_kinds = functools.cache(get_type_hints)


def read_row(record: type[Read], at: Any, *tables: Any, **others: Any) -> Read:
    """A record of the columns that are called as its fields, of the first table that has each."""
    kinds, found = _kinds(record), {}
    for name in {field.name for field in dataclasses.fields(record)} - set(others):  # pyright: ignore[reportArgumentType]
        column = next(getattr(table, name) for table in tables if hasattr(table, name))
        found[name] = kinds[name](column[at].item())
    return record(**found, **others)


def id_or_none(value: Any) -> int | None:
    """An id; None for `NO_ID`."""
    return None if int(value) == NO_ID else int(value)


def to_jsonable(value: Any) -> Any:
    """Nested dataclasses as `json` can write them; codes are words."""
    if dataclasses.is_dataclass(value):
        return {
            field.name: to_jsonable(getattr(value, field.name))
            for field in dataclasses.fields(value)
        }
    if isinstance(value, enum.Enum):
        return value.name.lower()
    if isinstance(value, Mapping):
        return {str(key): to_jsonable(item) for key, item in value.items()}
    if isinstance(value, (tuple, list)):
        return [to_jsonable(item) for item in value]
    if isinstance(value, float):
        return round(value, 6) if np.isfinite(value) else None
    return value


def say_code(code: enum.Enum) -> str:
    """A code in words: `provisional new`."""
    return code.name.lower().replace("_", " ")


def wrap(text: str, width: int | None, *, head: str = "", indent: int = 2) -> list[str]:
    """The lines of a paragraph; all but the first are indented."""
    most = min(width or _MAX_WIDTH, _MAX_WIDTH)
    return textwrap.wrap(text, most, initial_indent=head, subsequent_indent=" " * indent)


def lay_out(
    rows: Sequence[Sequence[str]], is_text: Sequence[int], width: int | None = None
) -> list[str]:
    """Lines of a table; columns `is_text` are flush left, the others right.

    Where the table is wider than `width`, the columns that do not fit follow below, with the first
    column again.
    """
    sizes = [max(map(len, column)) for column in zip(*rows, strict=True)]
    lines = []
    for columns in split_columns(sizes, width or sum(sizes) + 2 * len(sizes), around_cell=2):
        left = [place for place, column in enumerate(columns) if column in is_text]
        widths = [sizes[column] for column in columns]
        lines += [align([row[column] for column in columns], widths, left) for row in rows]
    return lines


def render_frame(tracks: Tracks) -> str:
    """The detections of a frame, to choose one from."""
    rows = [
        (
            str(row),
            tracks.display_name(row),
            say_code(Outcome(int(tracks.outcome[row]))),
            _number(tracks.shown_score(row)),
            _number(tracks.shown_confidence(row)),
        )
        for row in range(len(tracks))
    ]
    title = f"frame {tracks.frame_index} ({tracks.time_s:.2f} s, {tracks.name})"
    if not rows:
        return f"{title}: nothing was detected"
    table = [("detection", "name", "outcome", "score with context", "confidence"), *rows]
    if not any(row[3] for row in rows):
        table = [(*row[:3], row[4]) for row in table]
    return "\n".join((title, *lay_out(table, (1, 2))))


def _number(value: float | None) -> str:
    return "" if value is None else number(value)
