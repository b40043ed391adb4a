"""What `print` and notebooks show of a large thing: a headline, facts, a few rows."""

from __future__ import annotations

import dataclasses
import html
from collections.abc import Sequence

from remind_jax.printing.terminal import split_columns

_WIDTH = 80
_LINES, _HTML_ROWS = 12, 50  # that are shown at most
_GAP = "  "
_CELL_STYLE = "text-align:{};padding:.15em .7em .15em 0"


@dataclasses.dataclass(frozen=True)
class SmallTable:
    """A headline, sentences, and a table of text; columns after the first are flush right."""

    title: str
    facts: Sequence[str] = ()
    heads: Sequence[str] = ()
    rows: Sequence[Sequence[str]] = ()
    is_text: Sequence[int] = (0,)  # columns that are flush left

    def to_text(self, width: int = _WIDTH, max_lines: int = _LINES) -> str:
        """A few lines without an end; what did not fit is counted."""
        lines = [_shorten(self.title, width), *(f"  {_shorten(f, width - 2)}" for f in self.facts)]
        if not self.rows:
            return "\n".join(lines)
        room = max_lines - len(lines) - 1  # below the heads
        shown = self.rows if len(self.rows) <= room else self.rows[: room - 1]
        table = [[_shorten(cell, width // 2) for cell in row] for row in (self.heads, *shown)]
        widths = [max(map(len, column)) for column in zip(*table, strict=True)]
        num_columns = len(next(split_columns(widths, width, len(_GAP))))
        for row in table:
            lines.append(align(row[:num_columns], widths, self.is_text))
        left_out = [
            f"{number} more {thing}{'' if number == 1 else 's'}"
            for number, thing in (
                (len(self.rows) - len(shown), "row"),
                (len(widths) - num_columns, "column"),
            )
            if number
        ]
        if left_out:
            lines.append(f"{_GAP}and {', '.join(left_out)}")
        return "\n".join(lines)

    def to_html(self) -> str:
        """A fragment that needs no style sheet; all text is escaped."""
        parts = [f"<p><b>{html.escape(self.title)}</b></p>"]
        parts += [f"<p>{html.escape(fact)}</p>" for fact in self.facts]
        if self.rows:
            body = "".join(self._html_row(row, "td") for row in self.rows[:_HTML_ROWS])
            head = self._html_row(self.heads, "th")
            parts.append(f"<table><thead>{head}</thead><tbody>{body}</tbody></table>")
        if len(self.rows) > _HTML_ROWS:
            parts.append(f"<p>and {len(self.rows) - _HTML_ROWS} more rows</p>")
        return f"<div>{''.join(parts)}</div>"

    def _html_row(self, row: Sequence[str], tag: str) -> str:
        cells = [
            f'<{tag} style="{_CELL_STYLE.format("left" if place in self.is_text else "right")}">'
            f"{html.escape(cell)}</{tag}>"
            for place, cell in enumerate(row)
        ]
        return f"<tr>{''.join(cells)}</tr>"


class Printable:
    """Shows a summary in place of all that it holds."""

    def _summarize(self) -> SmallTable:
        raise NotImplementedError

    def __repr__(self) -> str:
        return self._summarize().to_text()

    def _repr_html_(self) -> str:
        """What notebooks show."""
        return self._summarize().to_html()


def align(row: Sequence[str], widths: Sequence[int], is_text: Sequence[int]) -> str:
    """A line of a table; columns `is_text` are flush left, the others right."""
    cells = [
        cell.ljust(size) if place in is_text else cell.rjust(size)
        for place, (cell, size) in enumerate(zip(row, widths, strict=False))
    ]
    return (_GAP + _GAP.join(cells)).rstrip()


def _shorten(text: str, width: int) -> str:
    """One line of at most so many characters."""
    line = " ".join(text.split())
    return line if len(line) <= width else line[: max(width - 3, 0)] + "..."
