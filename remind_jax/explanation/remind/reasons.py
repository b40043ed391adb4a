"""Why a detection became what it became: one function per stage, in the order of the tracker."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from remind_jax.decision import NO_ID, Outcome, Reason, Status
from remind_jax.explanation.remind.case import Case
from remind_jax.explanation.remind.doubts import (
    explain_birth,
    explain_doubt,
    explain_layout,
)
from remind_jax.printing.words import change, compare, listing, number, plural, sentence, threshold
from remind_jax.remind.association.gating import Gate
from remind_jax.remind.context.veto import Veto
from remind_jax.remind.stages import Lock, MatchOrigin

_VISIBLE = 0.005  # a change of score that shows in two decimals


def give_reasons(case: Case, since: tuple[int, int] | None = None) -> tuple[str, ...]:
    """The chain of a decision."""
    if case.reason == Reason.INVALID_INPUT:
        return ("Its mask is empty or has no finite feature, so it was left out.",)
    stages = (
        _explain_looks,
        _explain_context,
        _explain_vetoes,
        _explain_assignment,
        _explain_guard,
    )
    sentences = [text for stage in stages for text in stage(case)]
    before = None
    for turn in range(case.num_passes + 1):
        reason = case.undecided_reason(turn)
        if reason != before:
            sentences += explain_doubt(case, turn)
        if turn < case.num_passes:
            sentences += explain_layout(case, turn)
        before = reason
    sentences += explain_birth(case)
    sentences += _explain_double(case)
    return tuple(
        sentence(text) for text in (*dict.fromkeys(sentences), _explain_verdict(case, since))
    )


def _explain_looks(case: Case) -> Iterator[str]:
    """Which object it looks like, and how clear that is (method.md#status)."""
    num, label = case.trace("num_candidates"), case.label
    if num == 0:
        yield f"no {label} is known yet, so it can be none of those seen before"
        return
    first, *others = case.candidate_ids()
    best = f"{case.name(first)} ({number(case.decision('best_score'))})"
    if num == 1:
        yield f"the only {label} known is {best}"
    else:
        second = f", then {case.name(others[0])} ({number(case.decision('second_score'))})"
        yield f"of {plural(num, 'object')} of class {label} it looks most like {best}{second}"
    if status := _explain_status(case, alone=num == 1):
        yield status
    if case.trace("anchor_id") != NO_ID:
        yield (f"clear enough to be an anchor of the frame: {case.name(first)} counts as in view")


def _explain_status(case: Case, alone: bool) -> str:
    t, status = case.thresholds.diagnosis, Status(case.decision("status"))
    best, second = case.decision("best_score"), case.decision("second_score")
    lead, num_close = best - second, case.stage("num_close")
    if status == Status.STRONG:
        ahead = "" if alone else f", ahead by {compare(lead, '>=', t.strong_gap)}"
        return f"that is STRONG evidence: {compare(best, '>=', t.strong_score)}{ahead}"
    if status == Status.WEAK:
        return f"that is WEAK evidence: {compare(best, '<', t.ambiguous_score)}"
    if status == Status.AMBIGUOUS:
        doubts = []
        if best < t.strong_score:
            doubts.append(f"{compare(best, '<', t.strong_score)} of strong evidence")
        if lead < t.strong_gap:
            doubts.append(f"ahead by only {compare(lead, '<', t.strong_gap)}")
        if num_close > 1:
            doubts.append(f"{num_close} candidates within {threshold(t.close)}")
        reached = compare(best, ">=", t.ambiguous_score)
        return f"that is AMBIGUOUS evidence: {reached}, but {listing(doubts)}"
    return ""


def _explain_context(case: Case) -> Iterator[str]:
    """What the surroundings add or take.

    Rules: method.md#cooccurrence-bonus, method.md#context-allowed.
    """
    context, t = case.record.context, case.thresholds.influence
    ids = case.candidate_ids()
    if not ids:
        return
    if not context.enabled:
        yield "context is switched off, so looks alone count"
        return
    if not context.usable:
        yield f"context changes no score: {_explain_poor_context(case)}"
        return
    changes = [(i, case.candidate(i, "bonus_raw"), case.candidate(i, "bonus")) for i in ids]
    changes = [row for row in changes if abs(row[1]) >= _VISIBLE]
    quality = f"context (quality {compare(float(context.quality), '>=', t.min_quality)})"
    if not changes:
        yield f"{quality} neither backs nor contradicts a candidate"
        return
    backs = [f"{case.name(i)} ({change(raw)})" for i, raw, _ in changes if raw > 0]
    against = [f"{case.name(i)} ({change(raw)})" for i, raw, _ in changes if raw < 0]
    parts = [
        f"{verb} {listing(names)}"
        for verb, names in (("backs", backs), ("contradicts", against))
        if names
    ]
    is_unused = all(applied == 0 for _, _, applied in changes)
    unused = f", but {_explain_unused(case)}, so the scores stay" if is_unused else ""
    yield f"{quality} {' and '.join(parts)}{unused}"


def _explain_unused(case: Case) -> str:
    """Why the context changed no score (method.md#context-allowed)."""
    status = case.decision("status")
    if status == Status.STRONG:
        return "the evidence is strong without it"
    kind = "ambiguous" if status == Status.AMBIGUOUS else "weak"
    return f"this configuration uses no context where the evidence is {kind}"


def _explain_poor_context(case: Case) -> str:
    """The first test that the context failed (method.md#context-quality)."""
    sets, t = case.record.sets, case.thresholds.influence
    if not len(sets.score):
        return "no set of known objects explains the frame"
    size = int(np.sum(sets.member_id[0] != NO_ID))
    score, coverage = float(sets.score[0]), float(sets.coverage[0])
    if size < t.min_size:
        return f"the best set of objects has {plural(size, 'member')}, fewer than {t.min_size}"
    if score < t.min_best_score:
        return f"the best set of objects scores {compare(score, '<', t.min_best_score)}"
    if coverage < t.min_coverage:
        return f"the best set of objects covers {compare(coverage, '<', t.min_coverage)}"
    quality = float(case.record.context.quality)
    return f"its quality is {compare(quality, '<', t.min_quality)}"


def _explain_vetoes(case: Case) -> Iterator[str]:
    """Candidates that the surroundings rule out (method.md#veto)."""
    t = case.thresholds.veto
    ids = case.candidate_ids()
    outside = [i for i in ids if case.candidate(i, "veto") == Veto.OUTSIDE_CTX]
    if outside:
        worst = max(case.candidate(i, "relative_support") for i in outside)
        yield (
            f"context rules out {listing([case.name(i) for i in outside])}: it backs "
            f"{case.trace('kept_count')} of {plural(case.trace('num_candidates'), 'object')} of "
            f"class {case.label} and not these (relative support "
            f"{compare(worst, '<=', t.max_support)})"
        )
    for i in ids:
        if case.candidate(i, "veto") == Veto.LOCAL_CTX_CONTRADICTION:
            expected = case.candidate(i, "num_expected")
            seen = case.candidate(i, "num_expected_seen")
            share = compare(seen / max(expected, 1), "<", t.local_max_hit_share)
            yield (
                f"context rules out {case.name(i)}: of {plural(expected, 'object')} usually seen "
                f"with it {seen} {'is' if seen == 1 else 'are'} in view ({share})"
            )


def _explain_assignment(case: Case) -> Iterator[str]:
    """Which object it got: locks, then the joint assignment (11.4, 12, 13)."""
    if not case.candidate_ids():
        return
    assigned = case.stage("assigned_id")
    if assigned == NO_ID:
        yield _explain_unassigned(case)
        return
    lock = Lock(case.stage("lock"))
    yield _explain_lock(case, assigned, lock) if lock else _explain_joint(case, assigned)
    best = case.candidate_ids()[0]
    if best != assigned:
        yield f"{case.name(best)}, which it looks most like, {_explain_closed(case, best)}"


def _explain_lock(case: Case, assigned: int, lock: Lock) -> str:
    t, name = case.thresholds.matching, case.name(assigned)
    visual = case.candidate(assigned, "visual_score")
    rival, score = case.trace("rival"), case.trace("rival_score")
    if lock == Lock.DETECTION:
        taken = {i for i in case.candidate_ids() if _was_locked(case, i)}
        free = [
            i
            for i in case.candidate_ids()
            if i != assigned and i not in taken and case.candidate(i, "eligible")
        ]
        if not free:
            return (
                f"it is locked to {name} before the assignment: "
                f"{compare(visual, '>=', t.lock_score)} and no other candidate is open and free"
            )
        score, beaten = (
            case.candidate(free[0], "visual_score"),
            f"{case.name(free[0])}, its next one",
        )
    elif rival == NO_ID:
        return (
            f"it is locked to {name} before the assignment: "
            f"{compare(visual, '>=', t.lock_score)} and no other detection competes for it"
        )
    else:
        beaten = f"detection {rival}, the next one for it"
    lead = compare(visual - score, ">=", t.lock_gap)
    return (
        f"it is locked to {name} before the assignment: "
        f"{compare(visual, '>=', t.lock_score)}, ahead of {beaten}, by {lead}"
    )


def _explain_joint(case: Case, assigned: int) -> str:
    t, name = case.thresholds.matching, case.name(assigned)
    visual, final = (
        case.candidate(assigned, "visual_score"),
        case.candidate(assigned, "final_score"),
    )
    given = f"the {case.assignment} assignment of the frame gives it to this detection"
    if case.candidate(assigned, "gate") == Gate.SETS_RESCUE:
        bonus = case.candidate(assigned, "bonus")
        return (
            f"{name} is open although {compare(visual, '<', t.match)}: with the bonus of "
            f"{change(bonus)} it reaches {compare(final, '>=', t.match)}; {given}"
        )
    shown = compare(visual, ">=", t.match) if visual >= t.match else number(visual)
    after = "" if final == visual else f", with context {compare(final, '>=', t.match)}"
    return f"{name} is open for assignment ({shown}{after}) and {given}"


def _explain_unassigned(case: Case) -> str:
    """Why neither lock nor assignment found an object."""
    t = case.thresholds.matching
    opened = [i for i in case.candidate_ids() if case.candidate(i, "eligible")]
    for i in opened:
        holder = case.holder(i, "assigned_id")
        if holder is not None:
            return (
                f"the {case.assignment} assignment gives {case.name(i)} to detection {holder} and "
                f"leaves this one without an object"
            )
    for i in opened:
        final = case.candidate(i, "final_score")
        if final < t.match:
            return (
                f"the {case.assignment} assignment gives it {case.name(i)}, but after the penalty "
                f"of {change(case.candidate(i, 'bonus'))} the score is "
                f"{compare(final, '<', t.match)}"
            )
    best = case.candidate_ids()[0]
    return f"no candidate is open for assignment: {case.name(best)} {_explain_closed(case, best)}"


def _explain_closed(case: Case, object_id: int) -> str:
    """Why a candidate was not assigned, to follow its name."""
    t = case.thresholds.matching
    gate, visual = (
        Gate(case.candidate(object_id, "gate")),
        case.candidate(object_id, "visual_score"),
    )
    bonus = case.candidate(object_id, "bonus")
    if gate == Gate.NONE:
        return "is ruled out by context"
    if gate == Gate.BLOCK_MIN_MATCH:
        return f"looks too unlike ({compare(visual, '<', t.min_visual)})"
    if gate == Gate.BLOCK_MATCH_THR:
        lifted = ""
        if bonus > 0:
            lifted = f", and {change(bonus)} from context does not lift it there"
            if visual < (least := case.thresholds.influence.rescue_visual):
                lifted = f", and context lifts none below {threshold(least)}"
        return f"misses the threshold ({compare(visual, '<', t.match)}{lifted})"
    holder = case.holder(object_id, "assigned_id")
    if holder is None:
        return "goes to no detection"
    if gate == Gate.BLOCK_USED_OBJECT:
        return f"was locked by detection {holder}"
    return f"goes to detection {holder}"


def _was_locked(case: Case, object_id: int) -> bool:
    holder = case.holder(object_id, "assigned_id")
    return holder is not None and int(case.record.stages.lock[holder]) == Lock.OBJECT


def _explain_guard(case: Case) -> Iterator[str]:
    """Look-alikes that could swap objects (method.md#identity-stability)."""
    before, after = case.stage("assigned_id"), case.stage("guarded_id")
    if before == after:
        return
    t, gap = case.thresholds.stability, case.trace("group_gap")
    groups = case.record.detections.group
    members = [str(row) for row in np.flatnonzero(groups == groups[case.row])]
    together = f"detections {listing(members)} could swap their objects"
    if 0 <= gap <= t.assignment_gap:
        lead = f"the best joint assignment leads by only {compare(gap, '<=', t.assignment_gap)}"
        if after == NO_ID:
            yield f"{together}: {lead}, so the match with {case.name(before)} is withdrawn"
        else:
            yield f"{together}: {lead}; {case.name(after)} is the same in both"
    elif after == NO_ID:
        yield (
            f"{together}, and one of them depends on a bonus where a rival scores higher by "
            f"{threshold(t.alternative_margin)} or more: the match with {case.name(before)} is "
            "withdrawn"
        )
    else:
        yield f"{together}; solved again by falling score, it gets {case.name(after)}"


def _explain_double(case: Case) -> Iterator[str]:
    """An identity given twice, which no later rule repairs (method.md#one-detection-each)."""
    twin = case.holder(case.decision("object_id"), "object_id")
    if case.outcome == Outcome.MATCH and twin is not None:
        yield f"detection {twin} is matched with the same object: the frame holds it twice"


def _explain_verdict(case: Case, since: tuple[int, int] | None) -> str:
    """What it is."""
    outcome, object_id = case.outcome, case.decision("object_id")
    if outcome == Outcome.MATCH:
        score = number(case.decision("score"))
        context = " with context" if case.candidate(object_id, "bonus") else ""
        settled = case.stage("source") > MatchOrigin.ASSOCIATION
        return f"{'settled' if settled else 'matched'} as {case.name(object_id)} ({score}{context})"
    if outcome == Outcome.NEW:
        return f"a new object: {case.name(object_id)}"
    if outcome == Outcome.UNASSIGNED:
        return "it stays without identity and leaves no memory"
    names = [case.name(i) for i, _ in case.options()]
    kind = "ambiguous" if outcome == Outcome.AMBIGUOUS else "provisional"
    track = f"{kind} track {case.decision('pending_id')}"
    if since is not None:
        first, count = since
        seen = "its first detection" if count == 1 else f"{count} detections since frame {first}"
        track += f", {seen}"
    if outcome == Outcome.AMBIGUOUS:
        return f"open between {listing(names)} ({track})"
    if outcome == Outcome.PROVISIONAL_PARENT:
        return f"probably {listing(names, 'or')}, to be confirmed ({track})"
    related = f"; {listing(names, 'or')} cannot be excluded" if names else ""
    return f"probably new{related} ({track})"
