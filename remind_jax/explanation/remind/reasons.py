"""The decision about one detection in sentences, in the order of the tracker."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from remind_jax.decision import Outcome, Reason, Status
from remind_jax.explanation.remind.explanation import Candidate, KnownSet, Option, RemindExplanation
from remind_jax.printing.words import change, compare, listing, number, plural, sentence
from remind_jax.remind.association.gating import Gate
from remind_jax.remind.context.veto import Veto
from remind_jax.remind.disambiguation.joint_assignments import GroupStatus
from remind_jax.remind.stages import Lock, MatchOrigin
from remind_jax.remind.thresholds import Thresholds

_VISIBLE = 0.005  # a change of score that shows in two decimals

# Why a detection was undecided, to be followed by the objects in question.
_DOUBTS = {
    Reason.KNOWN_BUT_AMBIGUOUS: "context backs several that are too close on common evidence",
    Reason.KNOWN_BUT_AMBIGUOUS_MATCH: "context backs several that are too close on common evidence",
    Reason.KNOWN_BUT_AMBIGUOUS_VISUAL: "common evidence does not part those it looks like",
    Reason.KNOWN_BUT_AMBIGUOUS_VISUAL_MATCH: "common evidence does not part those it looks like",
    Reason.KNOWN_BUT_AMBIGUOUS_IDENTITY_STABILITY: "the guard of look-alikes leaves it open",
    Reason.KNOWN_AND_COMMITTED_NEW_COMPETITION:
        "a new detection claims an object that another holds with nearly the same score",
    Reason.KNOWN_BUT_AMBIGUOUS_BLOCKED_FALLBACK:
        "it found no object, and other detections hold all that context backs",
    Reason.KNOWN_BUT_AMBIGUOUS_CONTEXTUAL_FALLBACK:
        "it found no object, but context backs known ones well enough",
    Reason.KNOWN_BUT_HELD_BY_BETTER_MATCH:
        "its match was given up for another detection with a better score",
}  # fmt: skip
_BIRTHS = {
    Reason.UNCERTAIN_PARENT: "it is most likely the one known object that nothing excludes",
    Reason.UNCERTAIN_KNOWN_BLOCKED: "it resembles a known object that another detection holds",
    Reason.UNCERTAIN_NEW_WITH_KNOWN_CONTEXT: "context or looks speak for a known object",
    Reason.UNCERTAIN_NEW: "nothing excludes a known object",
    Reason.NO_ASSIGNMENT: "distances favor an object that does not exist yet",
}
_LAYOUT = {
    GroupStatus.TOO_LARGE_OR_SMALL: "they make no group of a size that can be solved",
    GroupStatus.NOT_CLOSED: "they make no closed group, one known object for each",
    GroupStatus.NO_ASSIGNMENT: "they allow no joint assignment",
    GroupStatus.VISUAL_RANK_FLIP: "looks favor another joint assignment",
}


def give_reasons(e: RemindExplanation, options: Sequence[Option], t: Thresholds) -> tuple[str, ...]:
    """The sentences of an explanation that has none yet."""
    if e.reason == Reason.INVALID_INPUT:
        return ("Its mask is empty or has no finite feature, so it was left out.",)
    texts = [
        *_explain_looks(e, t),
        *_explain_context(e),
        *_explain_assignment(e, t),
        *_explain_guard(e),
        *_explain_doubts(e, options, t),
        _explain_verdict(e, options),
    ]
    return tuple(sentence(text) for text in dict.fromkeys(texts))


def _explain_looks(e: RemindExplanation, t: Thresholds) -> Iterator[str]:
    """Which object it looks like, and how clear that is (method.md#status)."""
    if not e.candidates:
        yield f"no {e.label} is known yet, so it can be none of those seen before"
        return
    first, *others = e.candidates
    second = f", then {others[0].name} ({number(e.second_score)})" if others else ""
    yield (
        f"of {plural(e.num_candidates, 'object')} of class {e.label} it looks most like "
        f"{first.name} ({number(e.best_score)}){second}"
    )
    d, lead = t.diagnosis, e.best_score - e.second_score
    if e.status == Status.STRONG:
        ahead = f", ahead by {compare(lead, '>=', d.strong_gap)}" if others else ""
        yield f"that is STRONG evidence: {compare(e.best_score, '>=', d.strong_score)}{ahead}"
    elif e.status == Status.WEAK:
        yield f"that is WEAK evidence: {compare(e.best_score, '<', d.ambiguous_score)}"
    elif e.status == Status.AMBIGUOUS:
        yield (
            f"that is AMBIGUOUS evidence: ahead by {number(lead)}, where strong evidence has "
            f"{number(d.strong_score)} and leads by {number(d.strong_gap)}"
        )


def _explain_context(e: RemindExplanation) -> Iterator[str]:
    """What the surroundings add, take or rule out (method.md#cooccurrence-bonus)."""
    if not e.candidates:
        return
    if not e.context.enabled:
        yield "context is switched off, so looks alone count"
    elif not e.context.usable:
        yield f"context is too poor to change a score (quality {number(e.context.quality)})"
    else:
        changed = [c for c in e.candidates if abs(c.bonus_raw) >= _VISIBLE]
        sides = {
            "backs": [c for c in changed if c.bonus_raw > 0],
            "contradicts": [c for c in changed if c.bonus_raw < 0],
        }
        parts = [
            f"{verb} {listing([f'{c.name} ({change(c.bonus_raw)})' for c in those])}"
            for verb, those in sides.items()
            if those
        ]
        said = listing(parts) or "neither backs nor contradicts a candidate"
        unused = changed and all(c.bonus == 0 for c in changed)
        yield f"context {said}{', but is not allowed to change these scores' if unused else ''}"
    vetoed = [c.name for c in e.candidates if c.veto != Veto.NONE]
    if vetoed:
        yield f"context rules out {listing(vetoed)}"


def _explain_assignment(e: RemindExplanation, t: Thresholds) -> Iterator[str]:
    """Which object it got by a lock or the joint assignment, and what closed the best to it."""
    if not e.candidates:
        return
    match, best = t.matching.match, e.candidates[0]
    got = next((c for c in e.candidates if c.object_id == e.assigned_id), None)
    if got is None:
        yield f"no object is assigned to it: {best.name} {_explain_closed(best, t)}"
        return
    if e.lock != Lock.NONE:
        score = compare(got.visual_score, ">=", t.matching.lock_score)
        yield f"it is locked to {got.name} before the assignment: {score} and a clear lead"
    elif got.gate == Gate.SETS_RESCUE:
        yield (
            f"{got.name} is assigned to it although {compare(got.visual_score, '<', match)}: with "
            f"the bonus of {change(got.bonus)} it reaches {compare(got.final_score, '>=', match)}"
        )
    else:
        yield f"{got.name} is assigned to it: {compare(got.final_score, '>=', match)}"
    if got is not best:
        yield f"{best.name}, which it looks most like, {_explain_closed(best, t)}"


def _explain_closed(c: Candidate, t: Thresholds) -> str:
    """Why a candidate was not assigned, to follow its name."""
    m = t.matching
    if c.gate == Gate.NONE:
        return "is ruled out by context"
    if c.gate == Gate.BLOCK_MIN_MATCH:
        return f"looks too unlike ({compare(c.visual_score, '<', m.min_visual)})"
    if c.gate == Gate.BLOCK_MATCH_THR:
        return f"misses the threshold ({compare(c.visual_score, '<', m.match)})"
    if c.held_by is not None:
        return f"goes to detection {c.held_by}"
    if c.final_score < m.match:
        return f"is open, but with context {compare(c.final_score, '<', m.match)}"
    return "goes to no detection"


def _explain_guard(e: RemindExplanation) -> Iterator[str]:
    """Look-alikes that could swap objects (method.md#identity-stability)."""
    if e.assigned_id == e.guarded_id:
        return
    together = f"detections {listing([str(row) for row in e.swappable])} could swap their objects"
    if e.guarded_id is not None:
        yield f"{together}; solved again, this one gets {e.name_of(e.guarded_id)}"
    elif e.assigned_id is not None:
        yield f"{together}, so the match with {e.name_of(e.assigned_id)} is withdrawn"


def _explain_doubts(
    e: RemindExplanation, options: Sequence[Option], t: Thresholds
) -> Iterator[str]:
    """What kept it undecided, and what the distances to other objects said."""
    for known in e.known_sets:
        yield from _explain_doubt(e, known.reason, known.options)
        yield _explain_layout(e, known, t)
    if e.outcome != Outcome.MATCH:
        yield from _explain_doubt(e, e.reason, {one.object_id: one.score for one in options})
    if e.reason in _BIRTHS:
        yield _BIRTHS[e.reason]


def _explain_doubt(
    e: RemindExplanation, reason: Reason, options: dict[int, float]
) -> Iterator[str]:
    if reason in _DOUBTS:
        named = listing([f"{e.name_of(i)} ({number(score)})" for i, score in options.items()])
        yield f"{_DOUBTS[reason]}: {named}"


def _explain_layout(e: RemindExplanation, known: KnownSet, t: Thresholds) -> str:
    """What the distances to other objects said about a closed group (method.md#closed-groups)."""
    k, rows = t.known_sets, listing([str(row) for row in known.detections])
    if known.proposed_id is None:
        return f"distances are not used for detections {rows}: {_LAYOUT[known.status]}"
    voters = listing([voter.name for voter in known.voters]) or "others"
    favors = f"distances to {voters} favor {e.name_of(known.proposed_id)}"
    if known.status in (GroupStatus.RESOLVED, GroupStatus.PARTIAL_RESOLVED):
        score = compare(known.score, ">=", k.min_score)
        lead = compare(known.core_gap, ">=", k.min_core_gap)
        return f"{favors} for this one (joint score {score}, ahead by {lead})"
    numbers = f"joint score {number(known.score)}, ahead by {number(known.core_gap)}"
    why = _LAYOUT.get(known.status, f"{numbers}, evidence {number(known.evidence)}")
    return f"{favors} for this one, but not clearly: {why}"


def _explain_verdict(e: RemindExplanation, options: Sequence[Option]) -> str:
    """What it is."""
    names = [one.name for one in options]
    if e.outcome == Outcome.MATCH:
        assert e.object_id is not None
        score = "" if e.score is None else f" ({number(e.score)})"
        settled = e.source > MatchOrigin.ASSOCIATION
        return f"{'settled' if settled else 'matched'} as {e.name}{score}"
    if e.outcome == Outcome.NEW:
        return f"a new object: {e.name}"
    if e.outcome == Outcome.AMBIGUOUS:
        return f"open between {listing(names)}"
    if e.outcome == Outcome.PROVISIONAL_PARENT:
        return f"probably {listing(names, 'or')}, to be confirmed"
    if e.outcome == Outcome.UNASSIGNED:
        return "it stays without identity and leaves no memory"
    related = f"; {listing(names, 'or')} cannot be excluded" if names else ""
    return f"probably new{related}"
