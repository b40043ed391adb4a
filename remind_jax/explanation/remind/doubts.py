"""What kept a detection undecided, and what settled it. Rules: method.md."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from remind_jax.decision import NO_ID, Outcome, Reason
from remind_jax.explanation.remind.case import Case
from remind_jax.printing.words import compare, listing, number, percent, plural, threshold
from remind_jax.remind.disambiguation.joint_assignments import GroupStatus
from remind_jax.remind.memory.objects import Lifecycle

_BY_LOOKS = (Reason.KNOWN_BUT_AMBIGUOUS_VISUAL, Reason.KNOWN_BUT_AMBIGUOUS_VISUAL_MATCH)
_BY_POLICY = (
    *_BY_LOOKS,
    Reason.KNOWN_BUT_AMBIGUOUS,
    Reason.KNOWN_BUT_AMBIGUOUS_MATCH,
)
_FALLBACKS = (
    Reason.KNOWN_BUT_AMBIGUOUS_BLOCKED_FALLBACK,
    Reason.KNOWN_BUT_AMBIGUOUS_CONTEXTUAL_FALLBACK,
)


def explain_doubt(case: Case, turn: int) -> Iterator[str]:
    """Why a detection was undecided when a pass began (14.3 to 14.5, 16a)."""
    reason = case.undecided_reason(turn)
    options = case.options(turn if turn < case.num_passes else None)
    if reason is None:
        return
    if reason == Reason.KNOWN_AND_COMMITTED_NEW_COMPETITION:
        yield _explain_competition(case, options)
    elif reason == Reason.KNOWN_BUT_HELD_BY_BETTER_MATCH:
        yield _explain_second_claim(case, *options[0])
    elif reason in _BY_POLICY:
        yield _explain_closeness(case, reason, options)
    elif reason in _FALLBACKS:
        yield _explain_fallback(case, options)
    else:
        yield f"on common evidence it could still be {_list_options(case, options)}"


def _list_options(case: Case, options: list[tuple[int, float]]) -> str:
    return listing([f"{case.name(i)} ({number(score)})" for i, score in options])


def _explain_closeness(case: Case, reason: Reason, options: list[tuple[int, float]]) -> str:
    """Candidates too close to distinguish (method.md#ambiguity)."""
    t, matched = case.thresholds.ambiguous, case.stage("guarded_id")
    names = _list_options(case, options)
    is_unbacked = matched == options[0][0] and case.candidate(matched, "backed") is False
    rivals = [i for i, _ in options[1:] if case.candidate(i, "backed")]
    if is_unbacked and rivals and len(rivals) == len(options) - 1:
        own, theirs = (case.candidate(i, "assignment_score") for i in (matched, rivals[0]))
        gap = max(t.gap, t.clear_margin)
        if _is_close(own, theirs, gap, t.relative_gap, t.gap_slack):
            near = _explain_gap(own, theirs, gap, t.relative_gap, t.gap_slack)
            backed = listing([case.name(i) for i in rivals])
            return (
                f"context does not back {case.name(matched)} but {backed}, which "
                f"{'scores' if len(rivals) == 1 else 'score'} nearly the same: {near}"
            )
    scores = [score for _, score in options]
    near = _explain_gap(max(scores), min(scores), t.gap, t.relative_gap, t.gap_slack)
    if reason not in _BY_LOOKS:
        return f"context backs several, and they are too close on common evidence: {names}, {near}"
    visual = [case.candidate(i, "visual_score") for i, _ in options]
    if all(score is not None for score in visual) and max(visual) >= t.visual_min_top:
        looks = _explain_gap(max(visual), min(visual), t.visual_gap, t.relative_gap, t.visual_slack)
        return (
            f"they look too alike ({looks}) and common evidence does not part them: {names}, {near}"
        )
    return f"common evidence does not part them: {names}, {near}"


def _is_close(top: float, other: float, gap: float, relative: float, slack: float) -> bool:
    lack = abs(top - other)
    return lack <= gap + slack or lack / max(abs(top), abs(other), 1e-12) <= relative + slack


def _explain_gap(top: float, other: float, gap: float, relative: float, slack: float) -> str:
    """How near two scores are, by whichever of the two tests holds (method.md#plausible-score)."""
    top, other = max(top, other), min(top, other)
    lack = top - other
    if lack <= gap:
        return f"{compare(lack, '<=', gap)} apart"
    if lack <= gap + slack:
        return f"{number(lack)} apart, the limit {threshold(gap)} with a slack of {slack:g}"
    share = lack / max(abs(top), 1e-12)
    return f"{number(lack)} or {percent(share)} apart, within {percent(relative)}"


def _explain_competition(case: Case, options: list[tuple[int, float]]) -> str:
    """A new detection that claims an object already matched (method.md#competition)."""
    t, record = case.thresholds.competition, case.record
    parent, founded = options[0][0], options[1][0]
    seed = int(np.flatnonzero(record.detections.reserved_id == founded)[0])
    holder = int(np.flatnonzero(record.stages.guarded_id == parent)[0])
    claim = (
        f"detection {holder} holds {case.name(parent)}, and detection {seed}, which would be new, "
        "claims it too"
    )
    mine = case.candidate(parent, "known", seed)
    theirs = case.candidate(parent, "known", holder)
    if mine is None or theirs is None:
        return claim
    is_confirmed = case.candidate(parent, "lifecycle", seed) == Lifecycle.CONFIRMED
    least = t.confirmed_min_score if is_confirmed else t.min_score
    widest = t.confirmed_max_gap if is_confirmed else t.max_gap
    plausible = case.candidate(parent, "plausible", seed)
    if plausible and not case.candidate(parent, "eligible", seed):
        least, widest = min(least, t.min_score), max(widest, t.max_gap)
    return (
        f"{claim}: {number(theirs)} and {number(mine)}, both at least {threshold(least)} and "
        f"{compare(abs(theirs - mine), '<=', widest)} apart"
    )


def _explain_second_claim(case: Case, object_id: int, score: float) -> str:
    """A match given up, as nothing can be in two places (uniqueness.py)."""
    keeper = case.holder(object_id, "object_id")
    claim = f"it was matched with {case.name(object_id)} ({number(score)})"
    if keeper is None:
        return f"{claim}, but another detection claims it with a better score"
    better = number(float(case.record.decisions.score[keeper]))
    return f"{claim}, but detection {keeper} keeps it with the better score ({better})"


def _explain_fallback(case: Case, options: list[tuple[int, float]]) -> str:
    """A new object in doubt that context explains by several known objects (16a)."""
    t = case.thresholds.provisional
    best = compare(max(score for _, score in options), ">=", t.min_top)
    return (
        f"it found no object, but context backs known ones well enough ({best}): "
        f"{_list_options(case, options)}"
    )


def explain_layout(case: Case, turn: int) -> Iterator[str]:
    """What the distances to other objects said about a closed group (15)."""
    root, status = case.passes("root", turn), GroupStatus(case.passes("status", turn))
    if not case.passes("undecided", turn) or root < 0 or status == GroupStatus.NONE:
        return
    roots = case.record.detections.passes.root[:, turn]
    members = [str(row) for row in np.flatnonzero(roots == root)]
    num_objects = case.passes("num_objects", turn)
    group = (
        f"detection{'s' if len(members) > 1 else ''} {listing(members)} with "
        f"{plural(num_objects, 'object')} in question"
    )
    if status == GroupStatus.TOO_LARGE_OR_SMALL:
        yield f"distances are not used: {group} make no group of a size that can be solved"
    elif status == GroupStatus.NOT_CLOSED:
        yield f"distances are not used: {group} make no closed group, one known object for each"
    elif status == GroupStatus.NO_ASSIGNMENT:
        yield f"{group} allow no joint assignment"
    else:
        yield _explain_solution(case, turn, status, group)


def _explain_solution(case: Case, turn: int, status: GroupStatus, group: str) -> str:
    t = case.thresholds.known_sets
    score, core = case.passes("score", turn), case.passes("core", turn)
    core_gap, evidence = case.passes("core_gap", turn), case.passes("evidence", turn)
    proposed = case.name(case.passes("proposed_id", turn))
    voters = [case.name(int(i)) for i in case.passes("anchor_id", turn) if i != NO_ID]
    if status == GroupStatus.LOW_EVIDENCE:
        voting = f"to {listing(voters)} say" if voters else "say"
        weight = compare(evidence, "<", t.min_evidence)
        return f"distances {voting} too little about {group} (evidence {weight})"
    favors = f"distances to {listing(voters)} favor {proposed}"
    if status in (GroupStatus.RESOLVED, GroupStatus.PARTIAL_RESOLVED):
        return (
            f"{favors} for this one (joint score {compare(score, '>=', t.min_score)}, ahead by "
            f"{compare(core_gap, '>=', t.min_core_gap)})"
        )
    why = {
        GroupStatus.LOW_SCORE: lambda: f"joint score {compare(score, '<', t.min_score)}",
        GroupStatus.VISUAL_RANK_FLIP: lambda: "looks favor another joint assignment",
        GroupStatus.LOW_CORE_SCORE: lambda: f"score {compare(core, '<', t.min_core)}",
        GroupStatus.LOW_CORE_GAP: lambda: f"ahead by only {compare(core_gap, '<', t.min_core_gap)}",
    }[status]()
    return f"{favors} for this one, but not clearly: {why}"


def explain_birth(case: Case) -> Iterator[str]:
    """Why a detection without an object is new, or only provisionally so (16)."""
    if case.outcome == Outcome.NEW and case.trace("num_candidates"):
        yield _explain_new(case)
    elif case.outcome in (Outcome.PROVISIONAL_NEW, Outcome.PROVISIONAL_PARENT):
        yield _explain_provisional(case)
    elif case.outcome == Outcome.UNASSIGNED:
        yield "distances favor an object that does not exist yet"


def _explain_new(case: Case) -> str:
    t = case.thresholds.provisional
    if not t.enabled:
        return "births are not questioned (provisional tracks are switched off)"
    if not case.trace("num_backed"):
        return (
            "no known object is supported: context backs none, and no look misses the threshold "
            f"{threshold(case.thresholds.matching.match)} by little enough"
        )
    backed, score = case.trace("backed_id"), case.trace("backed_score")
    if score < t.min_top:
        return (
            f"context backs {case.name(backed)}, but it scores only "
            f"{compare(score, '<', t.min_top)}"
        )
    return (
        f"context backs {case.name(backed)} ({number(score)}), but it is neither the best on "
        "common evidence nor close enough to others to leave it open"
    )


def _explain_provisional(case: Case) -> str:
    t, options = case.thresholds.provisional, case.options()
    if not options:
        return f"nothing excludes a known object ({number(case.decision('score'))})"
    object_id, score = options[0]
    holder = case.holder(object_id, "guarded_id")
    taken = "" if holder is None else f"; but detection {holder} holds it"
    if case.candidate(object_id, "backed"):
        return f"context backs {case.name(object_id)} to {compare(score, '>=', t.min_top)}{taken}"
    match = case.thresholds.matching.match
    lack = compare(match - score, "<=", t.visual_margin)
    return (
        f"{case.name(object_id)} misses the threshold {threshold(match)} by only {lack}, ahead of "
        f"all others by at least {threshold(t.visual_min_gap)}{taken}"
    )
