"""What `print` and notebooks show of a large thing: a headline, facts, a few rows."""

from __future__ import annotations

import dataclasses
import html
from collections.abc import Sequence

from remind_jax.printing.terminal import split_columns
from remind_jax.printing.words import plural

_WIDTH = 80
_LINES = 12  # that are shown at most
_NOTEBOOK_WIDTH, _NOTEBOOK_LINES = 160, 60
_GAP = "  "


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
        lacking = {
            "more row": len(self.rows) - len(shown),
            "more column": len(widths) - num_columns,
        }
        if left_out := [plural(count, what) for what, count in lacking.items() if count]:
            lines.append(f"{_GAP}and {', '.join(left_out)}")
        return "\n".join(lines)


class Printable:
    """Shows a summary in place of all that it holds."""

    def _summarize(self) -> SmallTable:
        raise NotImplementedError

    def __repr__(self) -> str:
        return self._summarize().to_text()

    def _repr_html_(self) -> str:
        """What notebooks show: more of it."""
        text = self._summarize().to_text(_NOTEBOOK_WIDTH, _NOTEBOOK_LINES)
        return f"<pre>{html.escape(text)}</pre>"


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
