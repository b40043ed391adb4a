"""What a table of scores is made of: columns, which say how a number is written, and rows."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence
from typing import Literal

Kind = Literal["percent", "count", "seconds", "ms", "mib", "number"]
Better = Literal["higher", "lower"]
Interval = tuple[float, float]  # lower, upper end

NOTHING = "-"

_DIGITS_AFTER_POINT = {"percent": 2, "count": 0, "seconds": 1, "ms": 1, "mib": 0, "number": 3}

# Scores closer than this are equal: less than any format shows.
_SAME = 1e-9


@dataclasses.dataclass(frozen=True)
class Column:
    """One column of a comparison."""

    name: str  # key of the score
    kind: Kind = "number"  # percent: the score is a fraction and shown times 100
    better: Better | None = None
    label: str | None = None  # heading, if not the name

    @property
    def heading(self) -> str:
        """What stands above the column."""
        return self.label or self.name

    def format(self, value: float, *, is_end: bool = False) -> str:
        """A score as it is shown; ends of intervals have a digit less."""
        scale = 100.0 if self.kind == "percent" else 1.0
        digits = max(0, _DIGITS_AFTER_POINT[self.kind] - is_end)
        return f"{scale * value:.{digits}f}"


def _percents(*names: str) -> tuple[Column, ...]:
    return tuple(Column(name, "percent", "higher") for name in names)


_KNOWN = (
    *_percents("HOTA", "DetA", "AssA", "LocA", "MOTA", "MOTP", "IDF1", "IDP", "IDR", "Recovery"),
    Column("HardRecovery", "percent", "higher", "Hard rec."),
    Column("Opportunities", "count", None, "Returns"),
    Column("IDSW", "count", "lower"),
    Column("IDSWRate", "percent", "lower", "IDSW %"),
    Column("Frag", "count", "lower"),
    Column("MT", "count", "higher"),
    Column("PT", "count"),
    Column("ML", "count", "lower"),
    Column("IDs", "count"),
    Column("GT_IDs", "count", None, "Objects"),
    Column("FirmShare", "percent", None, "Firm"),
    Column("FirmAccuracy", "percent", "higher", "Firm right"),
    Column("AmbiguousShare", "percent", None, "Ambiguous"),
    Column("CandidateHitRate", "percent", "higher", "Set hit"),
    Column("CollapseAccuracy", "percent", "higher", "Settled right"),
    Column("WeakShare", "percent", "lower", "Weak"),
)
COLUMNS: dict[str, Column] = {column.name: column for column in _KNOWN}


def column_of(column: str | Column) -> Column:
    """A column by its name; an unknown name becomes a plain number."""
    return COLUMNS.get(column, Column(column)) if isinstance(column, str) else column


def format_cell(column: Column, value: float, interval: Interval | None = None) -> tuple[str, str]:
    """A score and its interval as they are shown; the second is empty without an interval."""
    if math.isnan(value):
        return NOTHING, ""
    if interval is None or math.isnan(interval[0]) or math.isnan(interval[1]):
        return column.format(value), ""
    low, high = (column.format(end, is_end=True) for end in interval)
    return column.format(value), f"{low} to {high}"


@dataclasses.dataclass(frozen=True)
class Row:
    """One method, tracker or setting."""

    name: str
    scores: Mapping[str, float]  # fractions, counts, milliseconds; NaN where undefined
    intervals: Mapping[str, Interval] = dataclasses.field(default_factory=dict)  # lower, upper end
    note: str = ""  # what a reader must know: "2 of 12 scenes failed"

    def score(self, column: Column) -> float:
        """The score of a column, NaN without one."""
        return self.scores.get(column.name, math.nan)

    def format(self, column: Column) -> tuple[str, str]:
        """The score of a column and its interval as they are shown; empty without an interval."""
        return format_cell(column, self.score(column), self.intervals.get(column.name))


def is_best(rows: Sequence[Row], row: Row, column: Column) -> bool:
    """Whether no other row of the column is better; False where there is nothing to compare."""
    values = [r.score(column) for r in rows if not math.isnan(r.score(column))]
    if column.better is None or math.isnan(row.score(column)) or len(values) < 2:
        return False
    best = max(values) if column.better == "higher" else min(values)
    return abs(row.score(column) - best) <= _SAME
