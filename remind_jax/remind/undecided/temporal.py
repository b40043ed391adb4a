"""Scores and tests shared by the rules about undecided detections (method.md#plausible-score).

Letters: `N` detections, `O` objects, `K = 3` named candidates.
"""

from __future__ import annotations

import dataclasses

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from remind_jax.decision import NUM_OPTIONS, Status
from remind_jax.numerics.absent import NO_SLOT
from remind_jax.numerics.pytree import choose, pytree
from remind_jax.numerics.ranks import pick_best
from remind_jax.numerics.reductions import reduce_together
from remind_jax.numerics.rounding import divide
from remind_jax.remind.association.gating import Pairs
from remind_jax.remind.association.similarity import Comparison, comparable_score
from remind_jax.remind.context.reasoning import Reasoning
from remind_jax.remind.disambiguation.groups import Undecided
from remind_jax.remind.thresholds import Thresholds
from remind_jax.remind.thresholds.outcome import Ambiguous, Provisional

PLAUSIBLE, CANDIDATES, SUPPORTED = 0, 1, 2
_TINY = 1e-12


@pytree
class PairTable:
    """All that the rules may ask about the pairs of a frame."""

    comparison: Comparison
    pairs: Pairs
    reasoning: Reasoning
    thresholds: Thresholds
    temporal: Float[Array, "3 N O"]  # T among all PLAUSIBLE candidates, CANDIDATES, SUPPORTED ones

    @property
    def plausible(self) -> Bool[Array, "N O"]:
        """Candidates that context does not veto."""
        return self.comparison.candidate & self.reasoning.plausible

    @property
    def supported(self) -> Bool[Array, "N O"]:
        """Plausible candidates that context clearly backs."""
        return self.plausible & self.reasoning.supported[None]


def tabulate_pairs(
    comparison: Comparison, pairs: Pairs, reasoning: Reasoning, thresholds: Thresholds
) -> PairTable:
    """The table of a frame, with T among the sets of candidates that several rules ask about."""
    nothing = jnp.zeros((3, *comparison.score.shape), comparison.score.dtype)
    table = PairTable(comparison, pairs, reasoning, thresholds, nothing)
    sets = jnp.stack([table.plausible, comparison.candidate, table.supported])
    among = jax.vmap(lambda members: temporal_score(table, members))(sets)
    return dataclasses.replace(table, temporal=among)


def prefer(first: Undecided, second: Undecided) -> Undecided:
    """Entries of both; where both have one, that of the first."""
    merged = choose(first.present, first, second)
    return dataclasses.replace(merged, present=first.present | second.present)


def temporal_score(table: PairTable, members: Bool[Array, "N O"]) -> Float[Array, "N O"]:
    """T: the final score, or the score comparable within a set of candidates and its context."""
    comparable = comparable_score(table.comparison, members, table.thresholds.similarity)
    bonus = table.reasoning.influence.bonus_raw
    known = jnp.maximum(table.pairs.score_final, comparable + bonus[None])
    return jnp.where(table.thresholds.ambiguous.known_set_score, known, table.pairs.score_final)


def is_close(
    top: Float[Array, "..."],
    other: Float[Array, "..."],
    gap: Float[Array, ""],
    relative: Float[Array, ""],
    slack: Float[Array, ""],
) -> Bool[Array, "..."]:
    """Whether a score is near the top one, in absolute terms or as a share of it."""
    lack = jnp.maximum(0.0, top - other)
    share = divide(lack, jnp.maximum(_TINY, jnp.abs(top)))
    return (lack <= gap + slack) | (share <= relative + slack)


def judge(
    scores: Float[Array, "N O"], members: Bool[Array, "N O"], t: Ambiguous | Provisional
) -> tuple[Int[Array, "N"], Bool[Array, "N O"], Float[Array, "N"]]:
    """The temporal diagnosis: status, the candidates near the top, and the top score."""
    top, some = reduce_together(
        ("max", jnp.where(members, scores, -jnp.inf)), ("any", members), axis=1
    )
    top = jnp.where(jnp.isfinite(top), top, 0.0)
    near = members & (scores >= t.min_candidate)
    near = near & is_close(top[:, None], scores, t.gap, t.relative_gap, t.gap_slack)
    several = jnp.sum(near, axis=1) >= 2
    weak = ~some | (top < t.min_top)
    status = jnp.where(several, Status.AMBIGUOUS, Status.STRONG)
    return jnp.where(weak, Status.WEAK, status), near, top


def rank(
    scores: Float[Array, "*B O"],
    members: Bool[Array, "*B O"],
    most: Int[Array, "..."] | int = NUM_OPTIONS,
    *,
    later_first: bool = False,
) -> tuple[Int[Array, "*B K"], Float[Array, "*B K"]]:
    """Slots and scores of the best members by falling score, at most three; padded by -1 and 0.

    `later_first`: among equals the larger id first, else the smaller.
    """
    slots, best = pick_best(scores, members, NUM_OPTIONS, later_first=later_first)
    asked = jnp.arange(NUM_OPTIONS) < most
    return jnp.where(asked, slots, NO_SLOT), jnp.where(asked, best, 0.0)


def to_mask(slots: Int[Array, "*B K"], width: int) -> Bool[Array, "*B O"]:
    """Marks the named slots; padding and virtual ones fall out."""
    return jnp.any(slots[..., None] == jnp.arange(width), axis=-2)
