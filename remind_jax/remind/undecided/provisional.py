"""Is an unmatched detection really new? (method.md#provisional)."""

from __future__ import annotations

import dataclasses

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from remind_jax.decision import Reason, Status
from remind_jax.numerics.absent import NO_SLOT
from remind_jax.numerics.pytree import choose, pytree
from remind_jax.numerics.ranks import rank_rising, rank_two
from remind_jax.numerics.reductions import reduce_together
from remind_jax.remind.association.diagnosis import admit_by_status
from remind_jax.remind.disambiguation.groups import Undecided
from remind_jax.remind.undecided.temporal import (
    CANDIDATES,
    PLAUSIBLE,
    PairTable,
    is_close,
    judge,
    rank,
    to_mask,
)


@pytree
class Doubts:
    """Unmatched detections that may be known after all."""

    ambiguous: Undecided  # several known objects
    present: Bool[Array, "N"]  # provisional
    reason: Int[Array, "N"]  # decision.Reason
    best: Float[Array, "N"]
    support: Int[Array, "N K"]  # slots of known objects that speak for it, -1 padding
    support_score: Float[Array, "N K"]
    blocked: Bool[Array, "N K"]  # support that another detection holds


def no_doubts(entries: Undecided) -> Doubts:
    """No doubt about any of the detections that `entries` is about."""
    nothing = jax.tree.map(jnp.zeros_like, entries)
    nowhere = jnp.full_like(entries.slot, NO_SLOT)
    return Doubts(
        ambiguous=dataclasses.replace(nothing, slot=nowhere),
        present=nothing.present,
        reason=nothing.reason,
        best=nothing.best,
        support=nowhere,
        support_score=nothing.score,
        blocked=jnp.zeros(entries.slot.shape, bool),
    )


def question_births(table: PairTable, creates: Bool[Array, "N"], held: Bool[Array, "O"]) -> Doubts:
    """Asks of every detection that would found an object whether it could be a known one."""
    t, thresholds = table.thresholds.provisional, table.thresholds
    candidate, plausible = table.comparison.candidate, table.plausible
    visual = table.comparison.score
    supported = table.supported
    score, raw_score = table.temporal[PLAUSIBLE], table.temporal[CANDIDATES]
    num_supported, num_plausible, num_candidates = jnp.sum(
        jnp.stack([supported, plausible, candidate]), axis=2
    )
    some = num_supported > 0
    status, _, _ = judge(score, jnp.where((num_supported >= 2)[:, None], supported, plausible), t)
    # The best of all sets of candidates that a detection may be compared within.
    slots, tops, seconds, _ = rank_two(
        jnp.stack([score, score, raw_score, visual, visual]),
        jnp.stack([supported, plausible, candidate, plausible, candidate]),
    )
    first, first_score, raw_top = slots[0], tops[0], slots[2]
    hint, hint_score = slots[4], tops[4]
    blocked_ok = some & held[first] & (first_score >= t.min_top)
    near_miss = _is_near_miss(table, tops[3:], seconds[3:])
    near_miss = near_miss & (~t.visual_single_only | (num_candidates == 1))
    near_miss = near_miss & t.visual_fallback & (~some | ~t.visual_only_without_context)
    admitted = admit_by_status(status, t.from_strong, t.from_ambiguous, t.from_weak)
    bad_status = ~admitted & ~blocked_ok & ~near_miss

    only_raw = ~some & (num_plausible == 0) & near_miss
    at_best = lambda leaf: jnp.where(only_raw, leaf[2], jnp.where(some, leaf[0], leaf[1]))  # noqa: E731
    best_slot, best = at_best(slots), at_best(tops)
    asked = creates & (num_candidates > 0) & ((num_plausible > 0) | only_raw) & t.enabled
    asked = asked & (some | near_miss | ~t.require_context) & (best >= t.min_top)

    near = supported & (score >= t.min_candidate)
    near = near & is_close(best[:, None], score, t.gap, t.relative_gap, t.gap_slack)
    known, known_score = rank(score, near, t.max_support)
    lacks = known[:, 0] == NO_SLOT
    asked = asked & (~lacks | near_miss | blocked_ok | ~t.require_context)
    by_hint = lacks & ~blocked_ok & near_miss  # the visual hint alone speaks for it
    lone, lone_score = choose(blocked_ok, (first, first_score), (hint, hint_score))
    filled = (jnp.arange(known.shape[1]) == 0) & (lacks & (blocked_ok | near_miss))[:, None]
    known = jnp.where(filled, lone[:, None], known)
    known_score = jnp.where(filled, lone_score[:, None], known_score)
    known, known_score = _promote(table, known, known_score, held)

    blocked = (known != NO_SLOT) & held[jnp.maximum(known, 0)]
    count, num_blocked = reduce_together(("sum", known != NO_SLOT), ("sum", blocked), axis=1)
    some_blocked = num_blocked > 0
    contextual = (count > 0) & ~(some_blocked & (num_blocked == count))
    aligned = (count == 1) & ~some_blocked
    aligned = aligned & jnp.where(
        by_hint, known[:, 0] == best_slot, (known[:, 0] == first) & (first == raw_top) & some
    )
    is_ambiguous = asked & (count >= 2)
    is_parent = (bad_status | near_miss) & (status == Status.STRONG) & contextual & aligned
    is_provisional = asked & ~is_ambiguous & (is_parent | ~bad_status)

    reason = jnp.where(count > 0, Reason.UNCERTAIN_NEW_WITH_KNOWN_CONTEXT, Reason.UNCERTAIN_NEW)
    reason = jnp.where(some_blocked, Reason.UNCERTAIN_KNOWN_BLOCKED, reason)
    reason = jnp.where(is_parent, Reason.UNCERTAIN_PARENT, reason)
    most = thresholds.ambiguous.max_candidates
    ambiguous = _as_entries(known, known_score, blocked, is_ambiguous, best, most)
    return Doubts(
        ambiguous=ambiguous,
        present=is_provisional,
        reason=reason.astype(jnp.int32),
        best=best,
        support=jnp.where(is_provisional[:, None], known, NO_SLOT),
        support_score=jnp.where(is_provisional[:, None], known_score, 0.0),
        blocked=blocked & is_provisional[:, None],
    )


def _is_near_miss(
    table: PairTable, tops: Float[Array, "2 N"], seconds: Float[Array, "2 N"]
) -> Bool[Array, "N"]:
    """A clear visual winner that just missed the match threshold (method.md#near-miss).

    `tops` and `seconds` are the two best visual scores of plausible ones and of all candidates.
    """
    thresholds, comparison = table.thresholds, table.comparison
    t, match = thresholds.provisional, thresholds.matching.match
    some = tops[0] > 0
    top, second = jnp.where(some, tops[0], tops[1]), jnp.where(some, seconds[0], seconds[1])
    among = jnp.where(some[:, None], table.plausible, comparison.candidate)
    near = among & (
        comparison.score >= (top - jnp.maximum(0.0, thresholds.diagnosis.close))[:, None]
    )
    lack = match - top
    ok = (top >= t.visual_min_score) & (match > 0)
    ok = ok & (lack >= 0) & (lack <= t.visual_margin) & (top - second >= t.visual_min_gap)
    return ok & (jnp.sum(near, axis=1) <= t.visual_max_close)


def _promote(
    table: PairTable, known: Int[Array, "N K"], known_score: Float[Array, "N K"], held: Array
) -> tuple[Int[Array, "N K"], Float[Array, "N K"]]:
    """Beside a lone support that is taken, names further ones (method.md#provisional)."""
    t, min_visual = table.thresholds.provisional, table.thresholds.matching.min_visual
    score, supported = table.temporal[PLAUSIBLE], table.supported
    named = known != NO_SLOT
    count, taken = reduce_together(
        ("sum", named), ("any", named & held[jnp.maximum(known, 0)]), axis=1
    )
    lone = (count == 1) & taken
    others = supported & ~to_mask(known, supported.shape[1])
    others = others & (score >= jnp.maximum(t.min_candidate, min_visual))
    lacking = jnp.maximum(1, t.max_support - 1)
    more, more_score = rank(score, others, lacking, later_first=True)
    slots = jnp.concatenate([known[:, :1], more[:, :-1]], axis=1)
    scores = jnp.concatenate([known_score[:, :1], more_score[:, :-1]], axis=1)
    return choose(lone, (slots, scores), (known, known_score))


def _as_entries(
    known: Int[Array, "N K"],
    known_score: Float[Array, "N K"],
    blocked: Bool[Array, "N K"],
    present: Bool[Array, "N"],
    best: Float[Array, "N"],
    max_candidates: Int[Array, ""],
) -> Undecided:
    """Support of at least two as ambiguous candidates, by score, then the larger id."""
    named = known != NO_SLOT
    key = jnp.where(named, known_score, -jnp.inf)
    place = rank_rising([-key, -known])
    is_at = place[:, None] == jnp.arange(known.shape[1])[:, None]
    slots, scores, taken = reduce_together(
        ("sum", jnp.where(is_at, known[:, None], 0)),
        ("sum", jnp.where(is_at, known_score[:, None], 0.0)),
        ("any", is_at & blocked[:, None]),
        axis=2,
    )
    keep = jnp.arange(known.shape[1]) < max_candidates
    slots = jnp.where(keep, slots, NO_SLOT)
    taken = taken | (slots == NO_SLOT)
    reason = jnp.where(
        jnp.all(taken, axis=1),
        Reason.KNOWN_BUT_AMBIGUOUS_BLOCKED_FALLBACK,
        Reason.KNOWN_BUT_AMBIGUOUS_CONTEXTUAL_FALLBACK,
    )
    return Undecided(
        present=present,
        slot=slots,
        score=jnp.where(slots != NO_SLOT, scores, 0.0),
        best=best,
        reason=reason.astype(jnp.int32),
    )
