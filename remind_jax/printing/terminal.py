"""Results on a terminal: as wide as it is, nothing cut off; in a file or pipe as wide as needed."""

from __future__ import annotations

import os
import re
import shutil
import sys
import textwrap
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

from remind_jax.errors import printable as printable

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table

_HIGH = 25  # without a height, rich takes the width of dumb terminals to be 80
_WIDE = 4000  # characters of a line where nothing limits it
_AROUND_CELL = 3  # characters of border and padding
_MAX_FOLDED = 36  # a column that is wider may be folded to fit
_PIPE = re.compile(r"(?<!\\)\|")


def output_width() -> int | None:
    """Columns of the terminal, or as many as COLUMNS says; None in a file or pipe: no limit."""
    if sys.stdout.isatty() or os.environ.get("COLUMNS", "").isdecimal():
        return shutil.get_terminal_size().columns
    return None


def wide_console(width: int | None) -> Console:
    """A console for tables of so many columns; None: as many as they need."""
    from rich.console import Console

    return Console(width=width or _WIDE, height=_HIGH)


def print_lines(*lines: str) -> None:
    """Prints sentences, wrapped between words on a terminal; paths stay in one piece."""
    width = output_width()
    for line in map(printable, lines):
        if width is None or len(line) <= width:
            print(line)
            continue
        indent = " " * (2 + len(line) - len(line.lstrip()))
        wrapped = textwrap.wrap(
            line, width, subsequent_indent=indent, break_long_words=False, break_on_hyphens=False
        )
        print("\n".join(wrapped))


def print_markdown(text: str) -> None:
    """Prints Markdown: as it is in a file or pipe, with its tables drawn on a terminal."""
    width, text = output_width(), printable(text)
    if width is None:
        print(text)
        return
    rows: list[list[str]] = []
    for line in [*text.splitlines(), ""]:
        if line.startswith("|"):
            cells = _PIPE.split(line)[1:-1]
            rows.append([cell.strip().replace("\\|", "|") for cell in cells])
            continue
        if rows:
            heads, _, *rest = rows
            print_table([heads, *rest])
            rows = []
        print_lines(line.lstrip("#").lstrip())


def print_table(
    lines: Sequence[Sequence[str]], title: str = "", is_text: Sequence[int] = (0,)
) -> None:
    """Prints a table of plain cells, the heads first; columns `is_text` are flush left."""
    console = wide_console(output_width())
    for table in lay_out(lines, console.width, title, is_text=is_text, is_markup=False):
        console.print(table)


def lay_out(
    lines: Sequence[Sequence[str]],
    width: int,
    title: str = "",
    *,
    is_text: Sequence[int] = (0,),
    is_markup: bool = True,
) -> Iterator[Table]:
    """Tables for `rich`: one if it fits, else several with the first column in each."""
    from rich.markup import escape
    from rich.table import Table

    shown = lines if is_markup else [[escape(printable(c)) for c in line] for line in lines]
    widths = [min(size, _MAX_FOLDED) for size in _natural_widths(shown)]
    for number, columns in enumerate(split_columns(widths, width - 1, _AROUND_CELL)):
        table = Table(title=escape(title) or None if number == 0 else None, title_justify="left")
        for place in columns:
            justify = "left" if place in is_text else "right"
            table.add_column(shown[0][place], justify=justify, overflow="fold")
        for line in shown[1:]:
            table.add_row(*(line[place] for place in columns))
        yield table


def _natural_widths(lines: Sequence[Sequence[str]]) -> list[int]:
    """Characters that the columns of a table take if nothing is folded, borders not counted."""
    from rich.text import Text

    def longest(cell: str) -> int:
        return max((part.cell_len for part in Text.from_markup(cell).split("\n")), default=0)

    return [max(map(longest, column)) for column in zip(*lines, strict=True)]


def split_columns(widths: Sequence[int], width: int, around_cell: int) -> Iterator[tuple[int, ...]]:
    """Columns by table: all if they fit, else as many as do, after the first one."""
    columns = (0,)
    for place in range(1, len(widths)):
        if len(columns) > 1 and sum(widths[i] + around_cell for i in (*columns, place)) > width:
            yield columns
            columns = (0,)
        columns = (*columns, place)
    yield columns
