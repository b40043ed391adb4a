"""Why the paper's tracker took a detection for what it did: everything the decision was made of.

Scores lie in [0, 1], those with context may exceed 1.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator

from remind_jax.decision import Reason, Status
from remind_jax.explanation.explanation import Explanation, Section, say_code
from remind_jax.printing.words import change, listing, number
from remind_jax.remind.association.gating import Gate
from remind_jax.remind.context.veto import Veto
from remind_jax.remind.disambiguation.joint_assignments import GroupStatus
from remind_jax.remind.memory.objects import Lifecycle
from remind_jax.remind.stages import Lock, MatchOrigin

_GATES = {
    Gate.NONE: "no",
    Gate.BLOCK_MIN_MATCH: "no: too unlike",
    Gate.BLOCK_MATCH_THR: "no: below match",
    Gate.BLOCK_USED_OBJECT: "no: locked by another",
    Gate.PASS_MATCH_THR: "open",
    Gate.SETS_RESCUE: "open: rescued",
}
_VETOES = {
    Veto.OUTSIDE_CTX: "no: ruled out, class",
    Veto.LOCAL_CTX_CONTRADICTION: "no: ruled out, neighbors",
}


@dataclasses.dataclass(frozen=True)
class Term:
    """One visual channel of a candidate."""

    score: float | None  # None: nothing to compare
    weight: float  # after the quality of observation and prototype


@dataclasses.dataclass(frozen=True)
class Candidate:
    """A known object that the detection was compared with."""

    object_id: int
    name: str
    lifecycle: Lifecycle  # before the frame
    unseen_frames: int
    terms: dict[str, Term]  # by channel
    visual_score: float  # weighted mean of the terms
    bonus: float  # from context, as applied
    bonus_raw: float  # from context, had it been allowed
    backed: bool  # clearly supported by context
    veto: Veto
    gate: Gate
    plausible: bool  # not vetoed
    assignment_score: float  # what the joint assignment maximized
    final_score: float  # what was tested for acceptance
    comparable_score: float  # on the evidence that all plausible candidates have, with context
    held_by: int | None  # other detection that got it


@dataclasses.dataclass(frozen=True)
class Context:
    """The context of the frame."""

    enabled: bool
    quality: float
    usable: bool  # good enough to change scores


@dataclasses.dataclass(frozen=True)
class Anchor:
    """A detection so clear that its object counts as seen when surroundings are judged."""

    detection: int
    object_id: int
    name: str


@dataclasses.dataclass(frozen=True)
class ObjectSet:
    """Objects that may be in view together."""

    score: float
    coverage: float
    object_ids: tuple[int, ...]
    names: tuple[str, ...]


@dataclasses.dataclass(frozen=True)
class Voter:
    """An object whose distances distinguish the members of a group."""

    name: str
    object_id: int
    detection: int
    distance: float  # from the detection to it, in object sizes
    remembered: dict[int, float]  # usual distance of each object in question to it


@dataclasses.dataclass(frozen=True)
class KnownSet:
    """What layout said about a closed group in one pass of the reconciliation."""

    turn: int  # pass, from 0
    status: GroupStatus
    reason: Reason  # why the detection was undecided
    detections: tuple[int, ...]
    options: dict[int, float]  # objects that this detection could be, with scores
    proposed_id: int | None  # object of this detection in the best joint assignment
    score: float
    second: float | None  # of the runner-up
    core_gap: float  # lead of the score without appearance
    evidence: float
    voters: tuple[Voter, ...]


@dataclasses.dataclass(frozen=True)
class Option:
    """An object that an undecided detection could be."""

    object_id: int
    name: str
    score: float
    blocked: bool  # held by another detection


@dataclasses.dataclass(frozen=True)
class PendingTrack:
    """The track of undecided detections that this one belongs to."""

    kind: str  # "ambiguous" or "provisional"
    track_id: int  # numbered per kind
    options: tuple[Option, ...]


@dataclasses.dataclass(frozen=True, kw_only=True)
class RemindExplanation(Explanation):
    """Why one detection became what it became."""

    FORMAT = "remind-jax explanation"
    VERSION = 2

    score: float | None  # with what context added, can exceed 1; None: there is none
    status: Status  # of the visual scores
    best_score: float
    second_score: float
    lock: Lock
    source: MatchOrigin
    assigned_id: int | None  # after locks and joint assignment
    guarded_id: int | None  # after the guard of look-alikes
    swappable: tuple[int, ...]  # detections of its group of look-alikes
    num_candidates: int  # in all
    candidates: tuple[Candidate, ...]  # the best of them, by falling visual score
    context: Context
    anchors: tuple[Anchor, ...]  # of the frame
    sets: tuple[ObjectSet, ...]  # of the frame, the most believable first
    known_sets: tuple[KnownSet, ...]
    pending: PendingTrack | None

    def name_of(self, object_id: int) -> str:
        """`mug 4`, or the name that people gave it."""
        named = {candidate.object_id: candidate.name for candidate in self.candidates}
        return named.get(object_id, f"{self.label} {object_id}")

    def _numbers(self) -> dict[str, float | None]:
        return {"score with context": self.score, "confidence": self.confidence}

    def sections(self) -> Iterator[Section]:
        """Candidates, surroundings, layout, and the track of undecided detections."""
        if self.candidates:
            yield _candidates(self)
        yield _surroundings(self)
        for known in self.known_sets:
            if known.proposed_id is not None:
                yield _known_set(self, known)
        if self.pending is not None:
            yield Section(_pending(self.pending))


def _candidates(e: RemindExplanation) -> Section:
    terms = [f"{term.replace('_', ' ')} x w" for term in e.candidates[0].terms]
    scores = ("visual", "context", "assign", "final", "common")
    heads = ("candidate", "state", *terms, *scores, "open to assignment")
    rows = [
        (
            f"{'*' if c.object_id == e.object_id else ' '} {c.name}",
            c.lifecycle.name.lower() + (f", unseen {c.unseen_frames}" if c.unseen_frames else ""),
            *map(_term, c.terms.values()),
            number(c.visual_score),
            _bonus(c),
            number(c.assignment_score),
            number(c.final_score),
            number(c.comparable_score) if c.plausible else "",
            _openness(c),
        )
        for c in e.candidates
    ]
    title = f"candidates ({len(e.candidates)} of {e.num_candidates})"
    return Section(title, (), heads, tuple(rows), (0, 1, len(heads) - 1))


def _term(term: Term) -> str:
    return "-" if term.score is None else f"{number(term.score)} x {number(term.weight)}"


def _bonus(c: Candidate) -> str:
    backed = "backed " if c.backed else ""
    if c.bonus != c.bonus_raw:
        return f"{backed}({change(c.bonus_raw)})"
    return f"{backed}{change(c.bonus)}" if c.bonus or backed else "-"


def _openness(c: Candidate) -> str:
    openness = _VETOES.get(c.veto) or _GATES[c.gate]
    return openness if c.held_by is None else f"{openness}; detection {c.held_by} got it"


def _surroundings(e: RemindExplanation) -> Section:
    """Anchors and sets of objects of the frame."""
    state = "off" if not e.context.enabled else "usable" if e.context.usable else "not usable"
    anchors = [f"{anchor.name} (detection {anchor.detection})" for anchor in e.anchors]
    lines = [f"anchors: {', '.join(anchors) or 'none'}"]
    if e.sets:
        lines.append(
            "sets of objects that explain the frame best, candidates of this detection in []"
        )
    mine = {candidate.object_id for candidate in e.candidates}
    for found in e.sets:
        pairs = zip(found.object_ids, found.names, strict=True)
        members = ", ".join(f"[{name}]" if i in mine else name for i, name in pairs)
        lines.append(f"  {number(found.score)} (covers {number(found.coverage)}): {members}")
    title = f"context of the frame: {state}, quality {number(e.context.quality)}"
    return Section(title, tuple(lines))


def _known_set(e: RemindExplanation, known: KnownSet) -> Section:
    assert known.proposed_id is not None
    detections = listing([str(row) for row in known.detections])
    options = [f"{e.name_of(i)} ({number(score)})" for i, score in known.options.items()]
    second = "none" if known.second is None else number(known.second)
    said = (
        f"detections {detections}; in question {listing(options, 'or')}; proposed "
        f"{e.name_of(known.proposed_id)}: score {number(known.score)} (second {second}), layout "
        f"alone ahead by {number(known.core_gap)}, evidence {number(known.evidence)}"
    )
    heads = ("voter", "away now", *(f"{e.name_of(i)} usually" for i in known.options))
    rows = [
        (
            f"{voter.name} (detection {voter.detection})",
            number(voter.distance),
            *(number(voter.remembered[i]) if i in voter.remembered else "-" for i in known.options),
        )
        for voter in known.voters
    ]
    title = f"layout, pass {known.turn + 1}: {say_code(known.status)}"
    return Section(title, (said,), heads, tuple(rows))


def _pending(p: PendingTrack) -> str:
    options = [
        f"{option.name} ({number(option.score)}{', held by another' if option.blocked else ''})"
        for option in p.options
    ]
    return f"{p.kind} track {p.track_id}: could be {listing(options, 'or') or 'nothing known'}"
