"""Which pairs may be assigned, and with what score? (paper III-E; method.md#gating)."""

from __future__ import annotations

import enum

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from remind_jax.numerics.pytree import pytree
from remind_jax.remind.association.similarity import Comparison
from remind_jax.remind.context.reasoning import Reasoning
from remind_jax.remind.thresholds import Thresholds


class Gate(enum.IntEnum):
    """Why a pair is, or is not, open to assignment (method.md#gating)."""

    NONE = 0  # no candidate, or vetoed by context
    BLOCK_MIN_MATCH = 1
    BLOCK_MATCH_THR = 2
    BLOCK_USED_OBJECT = 3
    PASS_MATCH_THR = 4
    SETS_RESCUE = 5  # below the threshold, opened by context


@pytree
class Pairs:
    """Score table; rows are detections, columns objects (method.md#pair-scores)."""

    eligible: Bool[Array, "N O"]  # open to assignment
    gate: Int[Array, "N O"]  # Gate
    score_assign: Float[Array, "N O"]  # what the assignment maximizes: visual, less penalties
    score_final: Float[Array, "N O"]  # what is tested for acceptance: visual and context
    score_known: Float[Array, "N O"]  # the same, with context even where it may not influence
    bonus: Float[Array, "N O"]  # context adjustment that was applied


def initial_pairs(score: Float[Array, "N O"]) -> Pairs:
    """The table before any gate: all scores visual, nothing eligible."""
    nothing = jnp.zeros(score.shape, bool)
    gate = jnp.full(score.shape, Gate.NONE, jnp.int32)
    return Pairs(nothing, gate, score, score, score, jnp.zeros_like(score))


def gate_pairs(
    pairs: Pairs,
    comparison: Comparison,
    reasoning: Reasoning,
    open_to_context: Bool[Array, "N"],
    rows: Bool[Array, "N"],
    used: Bool[Array, "O"],
    t: Thresholds,
) -> Pairs:
    """Opens the pairs that are good enough and rewrites the scores of those.

    Args:
      pairs: Table to update; rows outside `rows` and scores of closed pairs stay.
      open_to_context: Detections that context may influence (method.md#context-allowed).
      used: Objects already taken; they open the whole class to context.
    """
    candidate, score, matching = comparison.candidate, comparison.score, t.matching
    bonus_raw = reasoning.influence.bonus_raw
    allowed = open_to_context | jnp.any(candidate & used[None], axis=1)
    allowed = allowed & t.influence.enabled
    bonus = jnp.where(allowed[:, None], bonus_raw[None], 0.0)
    rescued = allowed[:, None] & (score >= t.influence.rescue_visual)
    rescued = rescued & (bonus > 0) & (score + bonus >= matching.match)
    low = (score < matching.min_visual) & matching.gate_min_visual
    below = (score < matching.match) & matching.gate_match

    gate = jnp.where(below & rescued, Gate.SETS_RESCUE, Gate.PASS_MATCH_THR)
    gate = jnp.where(used[None], Gate.BLOCK_USED_OBJECT, gate)
    gate = jnp.where(below & ~rescued, Gate.BLOCK_MATCH_THR, gate)
    gate = jnp.where(low, Gate.BLOCK_MIN_MATCH, gate)
    gate = jnp.where(candidate & reasoning.plausible, gate, Gate.NONE)
    row = rows[:, None]
    opened = row & (gate >= Gate.PASS_MATCH_THR)
    final = score + bonus
    known = jnp.maximum(final, score + bonus_raw[None])
    return Pairs(
        eligible=jnp.where(row, opened, pairs.eligible),
        gate=jnp.where(row, gate, pairs.gate).astype(jnp.int32),
        score_assign=jnp.where(opened, score + jnp.minimum(0.0, bonus), pairs.score_assign),
        score_final=jnp.where(opened, final, pairs.score_final),
        score_known=jnp.where(opened, known, pairs.score_known),
        bonus=jnp.where(row, bonus, pairs.bonus),
    )
