"""An explanation of REMIND plus as a page of plain text for a terminal."""

from __future__ import annotations

import textwrap

from remind_jax.explanation.text import WIDTH, align, say_confidence
from remind_jax.explanation.words import change, number
from remind_jax.plus.account import PlusExplanation
from remind_jax.plus.state import PARTS


def render_text(e: PlusExplanation) -> str:
    """The whole page; without a line end at its end."""
    outcome = e.outcome.name.lower().replace("_", " ")
    reason = e.reason.name.lower().replace("_", " ")
    lines = [
        f"frame {e.frame} ({e.time_s:.2f} s, {e.frame_name}), detection {e.detection}: {e.name}",
        f"{outcome} ({reason}){say_confidence(e.confidence)}",
        "",
        "why",
    ]
    for place, text in enumerate(e.why, start=1):
        mark = f"{place:3d}. "
        lines += textwrap.wrap(text, WIDTH, initial_indent=mark, subsequent_indent=" " * len(mark))
    if e.candidates:
        lines += ["", "candidates, evidence in log odds", *_table(e)]
    return "\n".join(lines)


def _table(e: PlusExplanation) -> list[str]:
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
    return align((heads, *rows), (0, len(heads) - 1))
