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
    PLAUSIBLE,
    PairTable,
    is_close,
    judge,
    rank,
    temporal_score,
    to_mask,
)


def find_ambiguous(table: PairTable, slot: Int[Array, "N"], creates: Bool[Array, "N"]) -> Undecided:
    """Detections, matched to a slot or not, whose candidates are too close to tell apart."""
    t, width = table.thresholds.ambiguous, table.plausible.shape[1]
    matched = slot >= 0
    mine = slot[:, None] == jnp.arange(width)
    held = jnp.any(mine, axis=0)
    status, _, _ = judge(table.temporal[PLAUSIBLE], table.plausible, t)
    admitted = admit_by_status(status, t.override_strong, t.override_ambiguous, t.override_weak)
    may_override = ~matched | (t.override_match & admitted)

    members = _open_candidates(table, mine, held, matched)
    score = temporal_score(table, members)
    supported = members & table.reasoning.supported[None]
    rivals = supported & ~mine
    sets = jnp.stack([members, supported, rivals, mine & members, mine & supported])
    num_members, num_supported, num_rivals, is_mine, mine_supported = jnp.sum(sets, axis=2)
    # An unsupported match beside supported rivals is compared with these.
    lone = matched & (mine_supported == 0) & (is_mine > 0) & (num_rivals > 0)
    ties = _visual_ties(table, members, num_supported, t)
    close = _close_rivals(table, mine, rivals & lone[:, None], t)
    most = jnp.stack([t.visual_max, t.max_candidates - 1, t.max_candidates - 1])
    best, _ = rank(
        jnp.stack([table.comparison.score, score, table.pairs.score_assign]),
        jnp.stack([ties, rivals, close]),
        most[:, None, None],
    )
    visual = to_mask(best[0], width)
    tied = jnp.sum(visual, axis=1) >= 2
    visual = visual & tied[:, None]
    focus = _focus(members, supported, visual, num_supported[:, None], tied[:, None], t)
    focus = jnp.where(lone[:, None], mine | to_mask(best[1, :, :2], width), focus)

    at_once = _conflict_entries(mine, close, best[2, :, :2], score)
    focus_score = temporal_score(table, focus)
    _, near, top = judge(focus_score, focus, t)
    slots, scores = rank(focus_score, near)
    count = jnp.sum(near, axis=1)
    backed = (num_supported >= 1) | tied | ~t.require_context
    later = may_override & (top >= t.min_top) & (count >= 2) & (count <= t.max_candidates) & backed

    asked = (matched & t.override_match) | creates
    asked = asked & (num_members >= 2) & t.enabled
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


def _open_candidates(
    table: PairTable,
    mine: Bool[Array, "N O"],
    held: Bool[Array, "O"],
    matched: Bool[Array, "N"],
) -> Bool[Array, "N O"]:
    """Plausible candidates that nobody else holds; held ones too if context backs several."""
    plausible = table.plausible
    free = plausible & (~held[None] | mine)
    num_free, num_supported = jnp.sum(jnp.stack([free, table.supported]), axis=2)
    lets_in = ~matched & (num_free < 2) & (num_supported >= 2)
    return jnp.where(lets_in[:, None], plausible, free)


def _visual_ties(
    table: PairTable, members: Bool[Array, "N O"], num_supported: Int[Array, "N"], t: Ambiguous
) -> Bool[Array, "N O"]:
    """Candidates whose visual score nearly ties with the best one."""
    score = table.comparison.score
    top = jnp.max(jnp.where(members, score, 0.0), axis=1, keepdims=True)
    near = members & is_close(top, score, t.visual_gap, t.relative_gap, t.visual_slack)
    without_context = (num_supported == 0)[:, None] | ~t.visual_only_without_context
    return near & (top >= t.visual_min_top) & t.visual_fallback & without_context


def _focus(
    members: Bool[Array, "N O"],
    supported: Bool[Array, "N O"],
    visual: Bool[Array, "N O"],
    num_supported: Int[Array, "N 1"],
    tied: Bool[Array, "N 1"],
    t: Ambiguous,
) -> Bool[Array, "N O"]:
    """The candidates that the question is about: supported ones, else visual ties."""
    two_supported = num_supported >= 2
    strict = jnp.where(two_supported, supported, visual) & (num_supported <= t.max_supported)
    loose = jnp.where(two_supported, supported, jnp.where(tied, visual, members))
    return jnp.where(t.supported_only, strict, loose)


def _close_rivals(
    table: PairTable, mine: Bool[Array, "N O"], rivals: Bool[Array, "N O"], t: Ambiguous
) -> Bool[Array, "N O"]:
    """Rivals that score nearly as the match does."""
    assign = table.pairs.score_assign
    own = jnp.sum(jnp.where(mine, assign, 0.0), axis=1, keepdims=True)
    gap = jnp.maximum(t.gap, t.clear_margin)
    top, low = jnp.maximum(own, assign), jnp.minimum(own, assign)
    return rivals & is_close(top, low, gap, t.relative_gap, t.gap_slack)


def _conflict_entries(
    mine: Bool[Array, "N O"],
    close: Bool[Array, "N O"],
    best: Int[Array, "N 2"],
    score: Float[Array, "N O"],
) -> Undecided:
    """An unsupported match and its best close rivals: ambiguous at once (method.md#ambiguity)."""
    match = jnp.argmax(mine, axis=1).astype(jnp.int32)
    slots = jnp.concatenate([match[:, None], best], axis=1)
    scores = jnp.take_along_axis(score, jnp.maximum(slots, 0), axis=1)
    scores = jnp.where(slots != NO_SLOT, scores, 0.0)
    return Undecided(
        present=jnp.any(close, axis=1),
        slot=slots,
        score=scores,
        best=jnp.max(scores, axis=1),
        reason=jnp.zeros(len(match), jnp.int32),
    )
