"""An explanation as a page of plain text for a terminal."""

from __future__ import annotations

import textwrap
from collections import Counter
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

from remind_jax.decision import Outcome
from remind_jax.explanation.remind.account import Candidate, Explanation, KnownSet, Term
from remind_jax.printing.terminal import split_columns
from remind_jax.printing.words import change, listing, number, plural
from remind_jax.remind.association.gating import Gate
from remind_jax.remind.context.veto import Veto
from remind_jax.remind.memory.objects import Lifecycle
from remind_jax.tracks import Tracks

if TYPE_CHECKING:
    from remind_jax.explanation.plus.account import PlusExplanation

_MOST_WIDTH = 100  # columns of running text
SHOWN_SETS = 5

GATES = {
    Gate.NONE: "no",
    Gate.BLOCK_MIN_MATCH: "no: too unlike",
    Gate.BLOCK_MATCH_THR: "no: below match",
    Gate.BLOCK_USED_OBJECT: "no: locked by another",
    Gate.PASS_MATCH_THR: "open",
    Gate.SETS_RESCUE: "open: rescued",
}
VETOES = {
    Veto.NONE: "",
    Veto.OUTSIDE_CTX: "no: ruled out, class",
    Veto.LOCAL_CTX_CONTRADICTION: "no: ruled out, neighbours",
}

_COLUMNS = ("visual", "context", "assign", "final", "common", "open to assignment")


def render_text(explanation: Explanation, width: int | None = None) -> str:
    """The whole page; without a line end at its end.

    Args:
      explanation: What to tell.
      width: Characters per line; tables are as wide as they need to be if left out.
    """
    e = explanation
    sections = (
        headline(e, {"score with context": e.score, "confidence": e.confidence}, width),
        ["", "why", *number_lines(e.why, width)],
        ["", *wrap(_candidates_title(e), width), *_candidates(e, width)] if e.candidates else [],
        ["", *_surroundings(e, width)],
        *(
            ["", *_known_set(e, known, width)]
            for known in e.known_sets
            if known.proposed_id is not None
        ),
        ["", *wrap(_pending(e), width)] if e.pending else [],
    )
    return "\n".join(line for section in sections for line in section)


def headline(
    e: Explanation | PlusExplanation, numbers: Mapping[str, float | None], width: int | None
) -> list[str]:
    """What is explained and what it became, with those of the numbers that there are."""
    outcome = e.outcome.name.lower().replace("_", " ")
    reason = e.reason.name.lower().replace("_", " ")
    told = [f"{name} {number(value)}" for name, value in numbers.items() if value is not None]
    place = f"frame {e.frame} ({e.time_s:.2f} s, {e.frame_name}), detection {e.detection}"
    became = ", ".join([f"{outcome} ({reason})", *told])
    return [*wrap(f"{place}: {e.name}", width), *wrap(became, width)]


def number_lines(sentences: Sequence[str], width: int | None) -> list[str]:
    """Numbered sentences."""
    return [
        line
        for place, text in enumerate(sentences, start=1)
        for line in wrap(text, width, head=f"{place:3d}. ", indent=5)
    ]


def wrap(text: str, width: int | None, *, head: str = "", indent: int = 2) -> list[str]:
    """The lines of a paragraph; all but the first are indented."""
    most = min(width or _MOST_WIDTH, _MOST_WIDTH)
    return textwrap.wrap(text, most, initial_indent=head, subsequent_indent=" " * indent)


def _candidates_title(e: Explanation) -> str:
    q = e.quality
    shown = f"{len(e.candidates)} of {e.num_candidates}" if e.num_candidates else "none"
    return (
        f"candidates ({shown}); seen well: object {number(q.object)}, background "
        f"{number(q.background)}, parts {number(q.parts)}; density {number(q.object_density)}, "
        f"{q.effective_patches:.1f} patches"
    )


def _candidates(e: Explanation, width: int | None) -> list[str]:
    terms = [f"{term.replace('_', ' ')} x w" for term in e.candidates[0].terms]
    heads = ("candidate", "state", *terms, *_COLUMNS)
    rows = [
        (
            f"{'*' if c.object_id == e.object_id else ' '} {c.name}",
            _state(c),
            *map(_term, c.terms.values()),
            number(c.visual_score),
            _context(c),
            number(c.assignment_score),
            number(c.final_score),
            number(c.comparable_score) if c.plausible else "",
            _openness(c),
        )
        for c in e.candidates
    ]
    return align((heads, *rows), (0, 1, len(heads) - 1), width)


def _state(c: Candidate) -> str:
    if c.lifecycle == Lifecycle.INACTIVE or c.unseen_frames:
        return f"{c.lifecycle.name.lower()}, unseen {c.unseen_frames}"
    return c.lifecycle.name.lower()


def _term(term: Term) -> str:
    return "-" if term.score is None else f"{number(term.score)} x {number(term.weight)}"


def _context(c: Candidate) -> str:
    backed = "backed " if c.backed else ""
    if c.bonus != c.bonus_raw:
        return f"{backed}({change(c.bonus_raw)})"
    return f"{backed}{change(c.bonus)}" if c.bonus or backed else "-"


def _openness(c: Candidate) -> str:
    told = VETOES[c.veto] or GATES[c.gate]
    return told if c.held_by is None else f"{told}; detection {c.held_by} got it"


def _surroundings(e: Explanation, width: int | None) -> list[str]:
    """Anchors and sets of objects of the frame."""
    state = "off" if not e.context.enabled else "usable" if e.context.usable else "not usable"
    lines = [f"context of the frame: {state}, quality {number(e.context.quality)}"]
    anchors = [f"{anchor.name} (detection {anchor.detection})" for anchor in e.anchors]
    lines += wrap(f"anchors: {', '.join(anchors) or 'none'}", width)
    return lines + (_sets(e, width) if e.sets else [])


def _sets(e: Explanation, width: int | None) -> list[str]:
    """The best sets; those of the same objects that explain other detections are one line."""
    times = Counter(found.object_ids for found in e.sets)
    distinct = list({found.object_ids: found for found in reversed(e.sets)}.values())[::-1]
    agree = sum(bool(found.agrees) for found in e.sets)
    voted = "" if e.sets[0].agrees is None else f"; {agree} of {len(e.sets)} agree"
    shown = min(len(distinct), SHOWN_SETS)
    lines = wrap(
        f"sets of objects that explain the frame best ({shown} of {len(distinct)}{voted}), "
        "candidates of this detection in brackets",
        width,
    )
    for found in distinct[:SHOWN_SETS]:
        members = ", ".join(
            f"[{name}]" if i in found.candidates else name
            for i, name in zip(found.object_ids, found.names, strict=True)
        )
        agrees = "" if found.agrees is None else ", agrees" if found.agrees else ", disagrees"
        count = f", {times[found.object_ids]} ways" if times[found.object_ids] > 1 else ""
        head = f"  {number(found.score)} (covers {number(found.coverage)}{count}{agrees}): "
        lines += wrap(head + members, width, indent=8)
    return lines


def _known_set(e: Explanation, known: KnownSet, width: int | None) -> list[str]:
    names = {c.object_id: c.name for c in e.candidates}

    def name(object_id: int) -> str:
        return names.get(object_id, f"{e.label} {object_id}")

    status = known.status.name.lower().replace("_", " ")
    lines = wrap(
        f"layout, pass {known.turn + 1}: {status}; detections "
        f"{listing([str(row) for row in known.detections])}; in question "
        f"{listing([f'{name(i)} ({number(s)})' for i, s in known.options.items()], 'or')}",
        width,
    )
    if known.proposed_id is not None:
        second = "none" if known.second is None else number(known.second)
        lines += wrap(
            f"  proposed {name(known.proposed_id)}: score {number(known.score)} (second {second}), "
            f"layout alone {number(known.core)} (ahead by {number(known.core_gap)}), evidence "
            f"{number(known.evidence)}",
            width,
            indent=4,
        )
    if known.voters:
        head = ("voter", "separates", "away now", *(f"{name(i)} usually" for i in known.options))
        rows = [
            (
                f"{voter.name} (detection {voter.detection})",
                number(voter.quality),
                number(voter.distance),
                *(
                    number(voter.remembered[i]) if i in voter.remembered else "-"
                    for i in known.options
                ),
            )
            for voter in known.voters
        ]
        lines += align((head, *rows), (0,), width)
    return lines


def _pending(e: Explanation) -> str:
    assert e.pending is not None
    p = e.pending
    options = [
        f"{option.name} ({number(option.score)}{', held by another' if option.blocked else ''})"
        for option in p.options
    ]
    return (
        f"{p.kind} track {p.track_id}: {plural(p.num_detections, 'detection')} since frame "
        f"{p.first_frame}; could be {listing(options, 'or') or 'nothing known'}"
    )


def render_frame(tracks: Tracks) -> str:
    """The detections of a frame, to choose one from."""
    rows = [
        (
            str(row),
            tracks.display_name(row),
            _outcome(tracks, row),
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
    return "\n".join((title, *align(table, (1, 2))))


def _number(value: float | None) -> str:
    return "" if value is None else number(value)


def _outcome(tracks: Tracks, row: int) -> str:
    return Outcome(int(tracks.outcome[row])).name.lower().replace("_", " ")


def align(
    rows: Sequence[Sequence[str]], left: Sequence[int], width: int | None = None
) -> list[str]:
    """Lines of a table; columns `left` are flush left, the others right.

    Where the table is wider than `width`, the columns that do not fit follow below, with the first
    column again.
    """
    sizes = [max(len(row[column]) for row in rows) for column in range(len(rows[0]))]
    lines = []
    for columns in split_columns(sizes, width or sum(sizes) + 2 * len(sizes), around_cell=2):
        for row in rows:
            cells = [
                row[c].ljust(sizes[c]) if c in left else row[c].rjust(sizes[c]) for c in columns
            ]
            lines.append(("  " + "  ".join(cells)).rstrip())
    return lines
