"""Why one detection became what it became, as far as this is the same for every method.

Keys of the JSON are the field names; absent values are null, codes are words.
"""

from __future__ import annotations

import abc
import dataclasses
import enum
from collections.abc import Iterator, Mapping
from typing import Any, ClassVar, Self

import numpy as np

from remind_jax.decision import NO_ID, Outcome, Reason
from remind_jax.explanation.text import number_lines, say_code, wrap
from remind_jax.printing.words import number


@dataclasses.dataclass(frozen=True, kw_only=True)
class Explanation(abc.ABC):
    """Why one detection became what it became; methods add what they decide by."""

    FORMAT: ClassVar[str]
    VERSION: ClassVar[int] = 1
    OF_FRAME: ClassVar[tuple[str, ...]] = ()  # fields that all detections of a frame have in common

    frame: int
    time_s: float
    frame_name: str
    detection: int
    label: str
    name: str  # `mug 4`, `mug 3 or 7?`
    outcome: Outcome
    reason: Reason
    object_id: int | None
    decided_at: int | None  # frame in which its object was decided on; None if it never was
    confidence: float | None  # None where it is left out
    why: tuple[str, ...]  # sentences, in the order in which it was decided

    def to_json(self) -> dict[str, Any]:
        """The same as `json` can write it."""
        return {"format": self.FORMAT, "version": self.VERSION} | to_jsonable(self)

    def to_text(self, width: int | None = None) -> str:
        """The same as a page of plain text, without a line end at its end.

        Args:
          width: Characters per line; tables are as wide as they need to be if left out.
        """
        sections = (
            self._headline(width),
            ["why", *number_lines(self.why, width)],
            *self._render_details(width),
        )
        return "\n\n".join("\n".join(lines) for lines in sections)

    def __str__(self) -> str:
        return self.to_text()

    def shortened(self) -> Self:
        """The same with what a page of the report has room for."""
        return self

    def _numbers(self) -> dict[str, float | None]:
        """What is said beside the outcome, by name."""
        return {"confidence": self.confidence}

    @abc.abstractmethod
    def _render_details(self, width: int | None) -> Iterator[list[str]]:
        """Lines of the sections below the reasons."""

    def _headline(self, width: int | None) -> list[str]:
        """What is explained and what it became, with those of the numbers that there are."""
        place = f"frame {self.frame} ({self.time_s:.2f} s, {self.frame_name})"
        numbers = [f"{name} {number(n)}" for name, n in self._numbers().items() if n is not None]
        became = ", ".join([f"{say_code(self.outcome)} ({say_code(self.reason)})", *numbers])
        return [
            *wrap(f"{place}, detection {self.detection}: {self.name}", width),
            *wrap(became, width),
        ]


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
