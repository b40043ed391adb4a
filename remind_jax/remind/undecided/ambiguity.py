"""Which detections could be one of several known objects? (method.md#ambiguity)."""

from __future__ import annotations

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from remind_jax.decision import Reason
from remind_jax.numerics.absent import NO_SLOT
from remind_jax.remind.association.diagnosis import admit_by_status
from remind_jax.remind.disambiguation.groups import Undecided
from remind_jax.remind.thresholds.outcome import Ambiguous
from remind_jax.remind.undecided.temporal import (
    PairTable,
    is_close,
    judge,
    rank,
    temporal_score,
    to_mask,
)


def find_ambiguous(
    table: PairTable, slot: Int[Array, "N"], creates: Bool[Array, "N"], t: Ambiguous
) -> Undecided:
    """Finds detections, matched or not, whose candidates are too close to tell apart.

    Args:
      table: Scores and gates of all pairs.
      slot: Matched object of each detection, -1 none.
      creates: Detections that would found an object.
      t: Thresholds.
    """
    width = table.plausible.shape[1]
    matched = slot >= 0
    mine = slot[:, None] == jnp.arange(width)
    held = jnp.any(mine, axis=0)
    status, _, _ = _judge(table, table.plausible, t)
    admitted = admit_by_status(status, t.override_strong, t.override_ambiguous, t.override_weak)
    may_override = ~matched | (t.override_match & admitted)

    members = _open_candidates(table, mine, held, matched)
    score = temporal_score(table, members)
    supported = members & table.context.supported[None]
    visual = _visual_ties(table, members, supported, t)
    num_supported, num_visual = jnp.sum(supported, axis=1), jnp.sum(visual, axis=1)

    focus = _focus(members, supported, visual, t)
    # An unsupported match beside supported rivals is compared with these.
    unsupported = matched & ~jnp.any(mine & supported, axis=1) & jnp.any(mine & members, axis=1)
    rivals = supported & ~mine
    lone = unsupported & jnp.any(rivals, axis=1)
    few, _ = rank(score, rivals, t.max_candidates - 1)
    focus = jnp.where(lone[:, None], mine | to_mask(few[:, :2], width), focus)

    at_once = _conflict_entries(table, mine, rivals & lone[:, None], score, t)
    _, near, top = _judge(table, focus, t)
    focus_score = temporal_score(table, focus)
    slots, scores = rank(focus_score, near)
    count = jnp.sum(near, axis=1)
    backed = (num_supported >= 1) | (num_visual >= 2) | ~t.require_context
    later = may_override & (top >= t.min_top) & (count >= 2) & (count <= t.max_candidates) & backed

    asked = (matched & t.override_match) | creates
    asked = asked & (jnp.sum(members, axis=1) >= 2) & t.enabled
    conflict = at_once.present
    by_match = jnp.where(
        num_supported < 2,
        Reason.KNOWN_BUT_AMBIGUOUS_VISUAL_MATCH,
        Reason.KNOWN_BUT_AMBIGUOUS_MATCH,
    )
    alone = jnp.where(
        num_supported < 2, Reason.KNOWN_BUT_AMBIGUOUS_VISUAL, Reason.KNOWN_BUT_AMBIGUOUS
    )
    return Undecided(
        present=asked & (conflict | later),
        slot=jnp.where(conflict[:, None], at_once.slot, slots),
        score=jnp.where(conflict[:, None], at_once.score, scores),
        best=jnp.where(conflict, at_once.best, top),
        reason=jnp.where(matched, by_match, alone).astype(jnp.int32),
    )


def _judge(
    table: PairTable, members: Bool[Array, "N O"], t: Ambiguous
) -> tuple[Int[Array, "N"], Bool[Array, "N O"], Float[Array, "N"]]:
    score = temporal_score(table, members)
    return judge(score, members, t.min_top, t.min_candidate, t.gap, t.relative_gap, t.gap_slack)


def _open_candidates(
    table: PairTable,
    mine: Bool[Array, "N O"],
    held: Bool[Array, "O"],
    matched: Bool[Array, "N"],
) -> Bool[Array, "N O"]:
    """Plausible candidates that nobody else holds; held ones too if context backs several."""
    plausible = table.plausible
    free = plausible & (~held[None] | mine)
    lets_in = ~matched & (jnp.sum(free, axis=1) < 2)
    lets_in = lets_in & (jnp.sum(plausible & table.context.supported[None], axis=1) >= 2)
    return jnp.where(lets_in[:, None], plausible, free)


def _visual_ties(
    table: PairTable, members: Bool[Array, "N O"], supported: Bool[Array, "N O"], t: Ambiguous
) -> Bool[Array, "N O"]:
    """Candidates whose visual score nearly ties with the best one, at least two."""
    score = table.comparison.score
    top = jnp.max(jnp.where(members, score, 0.0), axis=1, keepdims=True)
    near = members & is_close(top, score, t.visual_gap, t.relative_gap, t.visual_slack)
    without_context = ~jnp.any(supported, axis=1, keepdims=True) | ~t.visual_only_without_context
    near = near & (top >= t.visual_min_top) & t.visual_fallback & without_context
    slots, _ = rank(score, near, t.visual_max)
    near = to_mask(slots, members.shape[1])
    return near & (jnp.sum(near, axis=1, keepdims=True) >= 2)


def _focus(
    members: Bool[Array, "N O"],
    supported: Bool[Array, "N O"],
    visual: Bool[Array, "N O"],
    t: Ambiguous,
) -> Bool[Array, "N O"]:
    """The candidates that the question is about: supported ones, else visual ties."""
    num_supported = jnp.sum(supported, axis=1, keepdims=True)
    num_visual = jnp.sum(visual, axis=1, keepdims=True)
    two_supported, two_visual = num_supported >= 2, num_visual >= 2
    strict = jnp.where(two_supported, supported, visual) & (num_supported <= t.max_supported)
    loose = jnp.where(two_supported, supported, jnp.where(two_visual, visual, members))
    return jnp.where(t.supported_only, strict, loose)


def _conflict_entries(
    table: PairTable,
    mine: Bool[Array, "N O"],
    rivals: Bool[Array, "N O"],
    score: Float[Array, "N O"],
    t: Ambiguous,
) -> Undecided:
    """An unsupported match whose supported rivals score as well: ambiguous at once.

    Rule: method.md#ambiguity.
    """
    assign = table.pairs.score_assign
    own = jnp.sum(jnp.where(mine, assign, 0.0), axis=1, keepdims=True)
    gap = jnp.maximum(t.gap, t.clear_margin)
    top, low = jnp.maximum(own, assign), jnp.minimum(own, assign)
    close = rivals & is_close(top, low, gap, t.relative_gap, t.gap_slack)
    few, _ = rank(assign, close, t.max_candidates - 1)
    match = jnp.argmax(mine, axis=1).astype(jnp.int32)
    slots = jnp.concatenate([match[:, None], few[:, :2]], axis=1)
    scores = jnp.take_along_axis(score, jnp.maximum(slots, 0), axis=1)
    scores = jnp.where(slots != NO_SLOT, scores, 0.0)
    return Undecided(
        present=jnp.any(close, axis=1),
        slot=slots,
        score=scores,
        best=jnp.max(scores, axis=1),
        reason=jnp.zeros(len(match), jnp.int32),
    )
