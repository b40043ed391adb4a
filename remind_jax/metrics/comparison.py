"""Many methods, one table: for the terminal, Markdown, CSV, LaTeX and a page of its own.

A table is plain data, whoever filled it: `remind eval` with several predictions, the benchmark, a
sweep. Cells show a score and, where there is one, its interval; the best of a column is marked.

    table = ComparisonTable([Row("published", {"IDF1": 0.9}), Row("IoU", {"IDF1": 0.5})], ["IDF1"])
    print(table.to_markdown())
"""

from __future__ import annotations

import csv
import dataclasses
import io
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from remind_jax.errors import OutputError
from remind_jax.metrics.columns import Column, Interval, column_of, format_cell
from remind_jax.printing.small_table import Printable, SmallTable
from remind_jax.printing.terminal import (
    lay_out,
    natural_widths,
    output_width,
    table_width,
    wide_console,
)

if TYPE_CHECKING:
    from rich.console import Console


# Scores closer than this are equal: less than any format shows.
_SAME = 1e-9

_LATEX_ESCAPES = {
    "\\": r"\textbackslash{}",
    "~": r"\textasciitilde{}",
    "^": r"\textasciicircum{}",
    **{char: "\\" + char for char in "&%$#_{}"},
}


@dataclasses.dataclass(frozen=True)
class Row:
    """One method, tracker or setting."""

    name: str
    scores: Mapping[str, float]  # fractions, counts, milliseconds; NaN where undefined
    intervals: Mapping[str, Interval] = dataclasses.field(default_factory=dict)  # lower, upper end
    note: str = ""  # what a reader must know: "2 of 12 scenes failed"

    def format(self, column: Column) -> tuple[str, str]:
        """The score of a column and its interval as they are shown; empty without an interval."""
        return format_cell(
            column, self.scores.get(column.name, math.nan), self.intervals.get(column.name)
        )


@dataclasses.dataclass(frozen=True)
class Chart:
    """A score by bins, one line per method (breakdowns); drawn on the page only."""

    title: str
    bins: Sequence[str]
    series: Mapping[str, Sequence[float]]  # method: a score per bin; NaN where undefined
    supports: Sequence[int] = ()  # observations per bin
    column: str | Column = "IDF1"  # how the scores are written


@dataclasses.dataclass(frozen=True, repr=False)
class ComparisonTable(Printable):
    """Rows of scores under common columns."""

    rows: Sequence[Row]
    columns: Sequence[str | Column]  # names of `columns.COLUMNS`, or columns of one's own
    legend: Sequence[str] = ()  # sentences under the table: protocol, deviations, intervals
    title: str = ""
    charts: Sequence[Chart] = ()

    def _summarize(self) -> SmallTable:
        columns = self.resolved_columns
        return SmallTable(
            self.title or f"comparison of {len(self.rows)} rows",
            heads=("", *(column.heading for column in columns)),
            rows=[(row.name, *(row.format(column)[0] for column in columns)) for row in self.rows],
        )

    def to_text(self, *, width: int | None = None) -> str:
        """For a terminal; intervals stand under the scores.

        Args:
          width: Characters per line; as wide as needed if left out. Where the methods do not fit
            below each other with all columns, they stand beside each other; where these do not fit
            either, the columns are shared out among several tables.
        """
        console = wide_console(width)
        with console.capture() as capture:
            self.print(console)
        return "\n".join(line.rstrip() for line in capture.get().splitlines()) + "\n"

    def print(self, console: Console | None = None) -> None:
        """Prints the table to a `rich` console, by default that of the process."""
        console = console or wide_console(output_width())
        lines = self._cells()
        beside = [list(line) for line in zip(*lines, strict=True)]
        if (
            table_width(natural_widths(lines))
            > console.width
            >= table_width(natural_widths(beside))
        ):
            lines = beside
        for table in lay_out(lines, console.width, self.title):
            console.print(table)
        for sentence in self.legend:
            console.print(sentence, markup=False, highlight=False)

    def _cells(self) -> list[list[str]]:
        """Cells by row in markup of `rich`, the heads first."""
        from rich.markup import escape

        lines = [["", *(escape(column.heading) for column in self.resolved_columns)]]
        lines += [
            [escape(row.name), *(self._text_cell(row, c) for c in self.resolved_columns)]
            for row in self.rows
        ]
        if self._has_notes:
            notes = ["note", *(escape(row.note) for row in self.rows)]
            lines = [[*line, note] for line, note in zip(lines, notes, strict=True)]
        return lines

    def to_markdown(self) -> str:
        """A pipe table, the best of each column bold, and the legend as a list."""
        head = [
            "",
            *(c.heading for c in self.resolved_columns),
            *(["note"] if self._has_notes else []),
        ]
        rule = [
            "---",
            *("---:" for _ in self.resolved_columns),
            *(["---"] if self._has_notes else []),
        ]
        lines = [head, rule]
        for row in self.rows:
            cells = [self._inline_cell(row, column, "**{}**") for column in self.resolved_columns]
            lines.append([row.name, *cells, *([row.note] if self._has_notes else [])])
        table = "\n".join(
            "| " + " | ".join(cell.replace("|", "\\|") for cell in line) + " |" for line in lines
        )
        parts = [f"**{self.title}**"] if self.title else []
        parts += [table, *(["\n".join(f"* {line}" for line in self.legend)] if self.legend else [])]
        return "\n\n".join(parts) + "\n"

    def to_csv(self) -> str:
        """Scores at full precision, as they are (fractions); `X_low`, `X_high` for intervals."""
        out = io.StringIO()
        writer = csv.writer(out, lineterminator="\n")
        has_interval = {
            c.name: any(c.name in row.intervals for row in self.rows) for c in self.resolved_columns
        }
        head = ["name"]
        for column in self.resolved_columns:
            ends = (
                [f"{column.name}_low", f"{column.name}_high"] if has_interval[column.name] else []
            )
            head += [column.name, *ends]
        writer.writerow([*head, "note"])
        for row in self.rows:
            cells = [row.name]
            for column in self.resolved_columns:
                cells.append(_exact(row.scores.get(column.name, math.nan)))
                if has_interval[column.name]:
                    low, high = row.intervals.get(column.name, (math.nan, math.nan))
                    cells += [_exact(low), _exact(high)]
            writer.writerow([*cells, row.note])
        return out.getvalue()

    def to_latex(self) -> str:
        """A `table` environment for the `booktabs` package; the legend becomes the caption."""
        notes = self._has_notes
        head = [
            "",
            *(_latex(c.heading) for c in self.resolved_columns),
            *(["note"] if notes else []),
        ]
        lines = []
        for row in self.rows:
            cells = [self._latex_cell(row, column) for column in self.resolved_columns]
            lines.append([_latex(row.name), *cells, *([_latex(row.note)] if notes else [])])
        caption = " ".join(
            sentence if sentence.endswith((".", "!", "?")) else sentence + "."
            for sentence in ([self.title] if self.title else []) + list(self.legend)
        )
        body = "\n".join("    " + " & ".join(line) + r" \\" for line in lines)
        columns = "l" + "r" * len(self.resolved_columns) + ("l" if notes else "")
        return "\n".join(
            [
                r"\begin{table}",
                r"  \centering",
                *([rf"  \caption{{{_latex(caption)}}}"] if caption else []),
                rf"  \begin{{tabular}}{{{columns}}}",
                r"    \toprule",
                "    " + " & ".join(head) + r" \\",
                r"    \midrule",
                *([body] if body else []),
                r"    \bottomrule",
                r"  \end{tabular}",
                r"\end{table}",
                "",
            ]
        )

    def to_html(self, path: str | Path | None = None) -> str:
        """A page that needs nothing else: the table, plots with intervals, the legend.

        Args:
          path: Where to write it, if anywhere.

        Raises:
          OutputError: If matplotlib is not installed or the file cannot be written.
        """
        from remind_jax.metrics.comparison_page import render_page

        page = render_page(self)
        if path is not None:
            _write(Path(path), page)
        return page

    def save(self, path: str | Path) -> None:
        """Writes the table in the format of the name's ending: .md, .csv, .tex, .html or .txt.

        Raises:
          OutputError: If the ending is another one or the file cannot be written.
        """
        path = Path(path)
        render = {
            ".md": self.to_markdown,
            ".csv": self.to_csv,
            ".tex": self.to_latex,
            ".html": self.to_html,
            ".txt": self.to_text,
        }.get(path.suffix.lower())
        if render is None:
            raise OutputError(
                f"'{path}' ends in '{path.suffix}'; a table can be written as .md, .csv, .tex, "
                ".html or .txt"
            )
        _write(path, render())

    def is_best(self, row: Row, column: Column) -> bool:
        """Whether no other row of the column is better; False where there is nothing to compare."""
        value = row.scores.get(column.name, math.nan)
        values = [r.scores.get(column.name, math.nan) for r in self.rows]
        values = [v for v in values if not math.isnan(v)]
        if column.better is None or math.isnan(value) or len(values) < 2:
            return False
        best = max(values) if column.better == "higher" else min(values)
        return abs(value - best) <= _SAME

    @property
    def resolved_columns(self) -> tuple[Column, ...]:
        """The columns, names looked up."""
        return tuple(column_of(column) for column in self.columns)

    @property
    def _has_notes(self) -> bool:
        return any(row.note for row in self.rows)

    def _text_cell(self, row: Row, column: Column) -> str:
        score, interval = row.format(column)
        shown = f"[bold]{score}[/bold]" if self.is_best(row, column) else score
        return f"{shown}\n[dim]{interval}[/dim]" if interval else shown

    def _inline_cell(self, row: Row, column: Column, emphasis: str) -> str:
        score, interval = row.format(column)
        shown = emphasis.format(score) if self.is_best(row, column) else score
        return f"{shown} ({interval})" if interval else shown

    def _latex_cell(self, row: Row, column: Column) -> str:
        score, interval = row.format(column)
        shown = rf"\textbf{{{score}}}" if self.is_best(row, column) else score
        return rf"{shown} {{\scriptsize ({interval})}}" if interval else shown


def _exact(value: float) -> str:
    return "" if math.isnan(value) else repr(float(value))


def _latex(text: str) -> str:
    return "".join(_LATEX_ESCAPES.get(char, char) for char in text)


def _write(path: Path, text: str) -> None:
    try:
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        raise OutputError(f"cannot write '{path}': {error.strerror}") from error
