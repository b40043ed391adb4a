"""An explanation of REMIND plus as a page of plain text for a terminal."""

from __future__ import annotations

from remind_jax.explanation.plus.account import PlusExplanation
from remind_jax.explanation.remind.text import align, headline, number_lines
from remind_jax.plus.state import PARTS
from remind_jax.printing.words import change, number


def render_text(e: PlusExplanation, width: int | None = None) -> str:
    """The whole page; without a line end at its end.

    Args:
      e: What to tell.
      width: Characters per line; the table is as wide as it needs to be if left out.
    """
    lines = [
        *headline(e, {"confidence": e.confidence}, width),
        "",
        "why",
        *number_lines(e.why, width),
    ]
    if e.candidates:
        lines += ["", "candidates, evidence in log odds", *_table(e, width)]
    return "\n".join(lines)


def _table(e: PlusExplanation, width: int | None) -> list[str]:
    heads = ("candidate", *PARTS, "sum", "probability", "")
    rows = [
        (
            f"{'*' if c.object_id == e.answer_id else ' '} {c.name}",
            *(change(c.parts[part]) if c.parts[part] else "-" for part in PARTS),
            change(c.log_odds),
            number(c.probability),
            "" if c.held_by is None else f"detection {c.held_by} got it",
        )
        for c in e.candidates
    ]
    assert e.new_log_odds is not None
    assert e.new_probability is not None
    is_new = e.answer_id == e.tracklet_id
    new = f"{'*' if is_new else ' '} {e.label} {e.tracklet_id}, new"
    blank = [""] * len(PARTS)
    rows.append((new, *blank, change(e.new_log_odds), number(e.new_probability), ""))
    return align((heads, *rows), (0, len(heads) - 1), width)
