"""Many methods, one table of scores: for the terminal, Markdown and CSV."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from remind_jax.errors import OutputError
from remind_jax.files import check_place, writing
from remind_jax.files.csv_cells import csv_text
from remind_jax.printing.small_table import Printable, SmallTable
from remind_jax.printing.terminal import lay_out, output_width, wide_console
from remind_jax.printing.words import plural

if TYPE_CHECKING:
    from rich.console import Console


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


@dataclasses.dataclass(frozen=True)
class Row:
    """One method, tracker or setting."""

    name: str
    scores: Mapping[str, float]  # fractions, counts, milliseconds; NaN where undefined
    intervals: Mapping[str, Interval] = dataclasses.field(default_factory=dict)  # lower, upper end
    note: str = ""  # what a reader must know: "2 of 12 scenes failed"
    is_partial: bool = False  # scenes failed: its scores are not of what the others' are of

    def score(self, column: Column) -> float:
        """The score of a column, NaN without one."""
        return self.scores.get(column.name, math.nan)

    def format(self, column: Column) -> tuple[str, str]:
        """The score of a column and its interval as they are shown; empty without an interval."""
        value = self.score(column)
        if math.isnan(value):
            return NOTHING, ""
        ends = self.intervals.get(column.name, (math.nan, math.nan))
        if any(map(math.isnan, ends)):
            return column.format(value), ""
        low, high = (column.format(end, is_end=True) for end in ends)
        return column.format(value), f"{low} to {high}"


def is_best(rows: Sequence[Row], row: Row, column: Column) -> bool:
    """Whether no other row of the column is better, of those of all scenes.

    False where there is nothing to compare.
    """
    scored = [r for r in rows if not math.isnan(r.score(column))]
    if column.better is None or row not in scored or row.is_partial or len(scored) < 2:
        return False
    values = [r.score(column) for r in scored if not r.is_partial]
    best = max(values) if column.better == "higher" else min(values)
    return abs(row.score(column) - best) <= _SAME


def check_table_place(path: Path) -> None:
    """Makes sure that a table may be written there, before its scores are computed.

    Raises:
      OutputError: If the name has another ending than .md, .csv or .txt, or no file may lie there.
    """
    if path.suffix.lower() not in _RENDERED:
        raise OutputError(
            f"'{path}' ends in '{path.suffix}'; a table can be written as .md, .csv or .txt"
        )
    check_place(path)


@dataclasses.dataclass(frozen=True, repr=False)
class ComparisonTable(Printable):
    """Rows of scores under common columns."""

    rows: Sequence[Row]
    columns: Sequence[str | Column]  # names of `COLUMNS`, or columns of one's own
    legend: Sequence[str] = ()  # sentences under the table: protocol, deviations, intervals
    title: str = ""

    def _summarize(self) -> SmallTable:
        columns = self.resolved_columns
        return SmallTable(
            self.title or f"comparison of {plural(len(self.rows), 'row')}",
            heads=("", *(column.heading for column in columns)),
            rows=[(row.name, *(row.format(column)[0] for column in columns)) for row in self.rows],
        )

    def to_text(self, *, width: int | None = None) -> str:
        """For a terminal; intervals stand under the scores.

        Args:
          width: Characters per line; as wide as needed if left out. Columns that do not fit are
            shared out among several tables.
        """
        console = wide_console(width)
        with console.capture() as capture:
            self.print(console)
        return "\n".join(line.rstrip() for line in capture.get().splitlines()) + "\n"

    def print(self, console: Console | None = None) -> None:
        """Prints the table to a `rich` console, by default that of the process."""
        from rich.markup import escape

        console = console or wide_console(output_width())
        lines = self._cells(escape, "[bold]{}[/bold]", "{}\n[dim]{}[/dim]")
        for table in lay_out(lines, console.width, self.title):
            console.print(table)
        for sentence in self.legend:
            console.print(sentence, markup=False, highlight=False)

    def to_markdown(self) -> str:
        """A pipe table, the best of each column bold, and the legend as a list."""
        head, *lines = self._cells(lambda text: text.replace("|", "\\|"), "**{}**", "{} ({})")
        rule = ["---", *("---:" for _ in self.columns), *(["---"] if self._has_notes else [])]
        table = "\n".join("| " + " | ".join(line) + " |" for line in (head, rule, *lines))
        parts = [f"**{self.title}**"] if self.title else []
        parts += [table, *(["\n".join(f"* {line}" for line in self.legend)] if self.legend else [])]
        return "\n\n".join(parts) + "\n"

    def to_csv(self) -> str:
        """Scores at full precision, as they are (fractions); `X_low`, `X_high` for intervals.

        Text is guarded (`files/csv_cells.py`).
        """
        columns = self.resolved_columns
        has_interval = {c.name: any(c.name in row.intervals for row in self.rows) for c in columns}
        head = ["name"]
        for column in columns:
            ends = ("_low", "_high") if has_interval[column.name] else ()
            head += [column.name, *(column.name + end for end in ends)]
        lines = [[*head, "note"]]
        for row in self.rows:
            cells = [row.name]
            for column in columns:
                cells.append(_exact(row.score(column)))
                if has_interval[column.name]:
                    cells += map(_exact, row.intervals.get(column.name, (math.nan, math.nan)))
            lines.append([*cells, row.note])
        return csv_text(lines)

    def save(self, path: str | Path) -> None:
        """Writes the table in the format of the name's ending: .md, .csv or .txt.

        Raises:
          OutputError: If the ending is another one or the file cannot be written.
        """
        path = Path(path)
        check_table_place(path)
        render = _RENDERED[path.suffix.lower()]
        with writing(path):
            path.write_text(render(self), encoding="utf-8")

    @property
    def resolved_columns(self) -> tuple[Column, ...]:
        """The columns, names looked up."""
        return tuple(column_of(column) for column in self.columns)

    @property
    def _has_notes(self) -> bool:
        return any(row.note for row in self.rows)

    def _cells(self, escape: Callable[[str], str], best: str, interval: str) -> list[list[str]]:
        """Cells by row, the heads first, with marks around best scores and intervals."""
        columns = self.resolved_columns

        def show(row: Row, column: Column) -> str:
            score, ends = row.format(column)
            score = best.format(score) if is_best(self.rows, row, column) else score
            return interval.format(score, ends) if ends else score

        lines = [["", *(escape(column.heading) for column in columns)]]
        lines += [[escape(row.name), *(show(row, c) for c in columns)] for row in self.rows]
        if not self._has_notes:
            return lines
        notes = ["note", *(escape(row.note) for row in self.rows)]
        return [[*line, note] for line, note in zip(lines, notes, strict=True)]


# How a table is written, by the ending of its file.
_RENDERED = {
    ".md": ComparisonTable.to_markdown,
    ".csv": ComparisonTable.to_csv,
    ".txt": ComparisonTable.to_text,
}


def _exact(value: float) -> str:
    return "" if math.isnan(value) else repr(float(value))
