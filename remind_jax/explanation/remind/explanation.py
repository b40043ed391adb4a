"""Why the paper's tracker took a detection for what it did: everything the decision was made of."""

from __future__ import annotations

import dataclasses
from collections import Counter
from collections.abc import Iterator, Sequence

from remind_jax.decision import Status
from remind_jax.explanation.explanation import Explanation, lay_out, say_code, wrap
from remind_jax.explanation.remind.evidence import (
    Anchor,
    Candidate,
    Context,
    KnownSet,
    ObjectSet,
    PendingTrack,
    Quality,
    Term,
)
from remind_jax.printing.words import change, listing, number, plural
from remind_jax.remind.association.gating import Gate
from remind_jax.remind.context.veto import Veto
from remind_jax.remind.memory.objects import Lifecycle
from remind_jax.remind.stages import Lock, MatchOrigin

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
    Veto.LOCAL_CTX_CONTRADICTION: "no: ruled out, neighbors",
}

_COLUMNS = ("visual", "context", "assign", "final", "common", "open to assignment")


@dataclasses.dataclass(frozen=True, kw_only=True)
class RemindExplanation(Explanation):
    """Why one detection became what it became."""

    FORMAT = "remind-jax explanation"
    OF_FRAME = ("anchors", "context", "sets")

    score: float | None  # with what context added, can exceed 1; None: there is none
    status: Status  # of the visual scores
    status_final: Status  # of the final scores of open candidates
    best_score: float
    second_score: float
    num_close: int
    lock: Lock
    source: MatchOrigin
    assigned_id: int | None  # after locks and joint assignment
    guarded_id: int | None  # after the guard of look-alikes
    quality: Quality
    num_candidates: int  # in all
    candidates: tuple[Candidate, ...]  # the best of them, by falling visual score
    context: Context
    anchors: tuple[Anchor, ...]  # of the frame
    sets: tuple[ObjectSet, ...]  # of the frame, the most believable first
    known_sets: tuple[KnownSet, ...]
    pending: PendingTrack | None

    def shortened(self) -> RemindExplanation:
        """The same with the best sets only, each of other objects."""
        return dataclasses.replace(self, sets=distinct_sets(self.sets)[:SHOWN_SETS])

    def _numbers(self) -> dict[str, float | None]:
        return {"score with context": self.score, "confidence": self.confidence}

    def _render_details(self, width: int | None) -> Iterator[list[str]]:
        if self.candidates:
            yield [*wrap(_candidates_title(self), width), *_candidates(self, width)]
        yield _surroundings(self, width)
        for known in self.known_sets:
            if known.proposed_id is not None:
                yield _known_set(self, known, width)
        if self.pending is not None:
            yield wrap(_pending(self.pending), width)


def _candidates_title(e: RemindExplanation) -> str:
    q = e.quality
    shown = f"{len(e.candidates)} of {e.num_candidates}" if e.num_candidates else "none"
    return (
        f"candidates ({shown}); seen well: object {number(q.object)}, background "
        f"{number(q.background)}, parts {number(q.parts)}; density {number(q.object_density)}, "
        f"{q.effective_patches:.1f} patches"
    )


def _candidates(e: RemindExplanation, width: int | None) -> list[str]:
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
    return lay_out((heads, *rows), (0, 1, len(heads) - 1), width)


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
    openness = VETOES[c.veto] or GATES[c.gate]
    return openness if c.held_by is None else f"{openness}; detection {c.held_by} got it"


def _surroundings(e: RemindExplanation, width: int | None) -> list[str]:
    """Anchors and sets of objects of the frame."""
    state = "off" if not e.context.enabled else "usable" if e.context.usable else "not usable"
    lines = [f"context of the frame: {state}, quality {number(e.context.quality)}"]
    anchors = [f"{anchor.name} (detection {anchor.detection})" for anchor in e.anchors]
    lines += wrap(f"anchors: {', '.join(anchors) or 'none'}", width)
    return lines + (_sets(e, width) if e.sets else [])


def _sets(e: RemindExplanation, width: int | None) -> list[str]:
    """The best sets, one line for those of the same objects."""
    times = Counter(found.object_ids for found in e.sets)
    distinct = distinct_sets(e.sets)
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


def distinct_sets(sets: Sequence[ObjectSet]) -> tuple[ObjectSet, ...]:
    """The best of the sets of the same objects, which explain other detections by them."""
    best: dict[tuple[int, ...], ObjectSet] = {}
    for found in sets:
        best.setdefault(found.object_ids, found)
    return tuple(best.values())


def _known_set(e: RemindExplanation, known: KnownSet, width: int | None) -> list[str]:
    names = {c.object_id: c.name for c in e.candidates}

    def name(object_id: int) -> str:
        return names.get(object_id, f"{e.label} {object_id}")

    lines = wrap(
        f"layout, pass {known.turn + 1}: {say_code(known.status)}; detections "
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
        lines += lay_out((head, *rows), (0,), width)
    return lines


def _pending(p: PendingTrack) -> str:
    options = [
        f"{option.name} ({number(option.score)}{', held by another' if option.blocked else ''})"
        for option in p.options
    ]
    return (
        f"{p.kind} track {p.track_id}: {plural(p.num_detections, 'detection')} since frame "
        f"{p.first_frame}; could be {listing(options, 'or') or 'nothing known'}"
    )
