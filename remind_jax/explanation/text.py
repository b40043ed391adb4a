"""Pages of plain text for a terminal: paragraphs, numbered sentences and tables."""

from __future__ import annotations

import enum
import textwrap
from collections.abc import Sequence

from remind_jax.decision import Outcome
from remind_jax.printing.small_table import align
from remind_jax.printing.terminal import split_columns
from remind_jax.printing.words import number
from remind_jax.tracks import Tracks

_MOST_WIDTH = 100  # columns of running text


def say_code(code: enum.Enum) -> str:
    """A code in words: `provisional new`."""
    return code.name.lower().replace("_", " ")


def wrap(text: str, width: int | None, *, head: str = "", indent: int = 2) -> list[str]:
    """The lines of a paragraph; all but the first are indented."""
    most = min(width or _MOST_WIDTH, _MOST_WIDTH)
    return textwrap.wrap(text, most, initial_indent=head, subsequent_indent=" " * indent)


def number_lines(sentences: Sequence[str], width: int | None) -> list[str]:
    """Numbered sentences."""
    return [
        line
        for place, text in enumerate(sentences, start=1)
        for line in wrap(text, width, head=f"{place:3d}. ", indent=5)
    ]


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
