"""A new detection that looks like an object already matched: both stay open.

Rule: method.md#competition.
"""

from __future__ import annotations

import dataclasses

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Int

from remind_jax.decision import Reason
from remind_jax.numerics.absent import NO_SLOT
from remind_jax.remind.disambiguation.groups import Undecided
from remind_jax.remind.memory.objects import Lifecycle, Objects
from remind_jax.remind.thresholds.outcome import Competition
from remind_jax.remind.undecided.provisional_commit import reserve_ids
from remind_jax.remind.undecided.temporal import PairTable, temporal_score


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Rivalry:
    """Competitions of a frame, and what they found (method.md#provisional-commit)."""

    entries: Undecided
    reserved_id: Int[Array, "N"]  # id of the object that a detection founds, -1 none


def find_competitions(
    table: PairTable,
    objects: Objects,
    slot: Int[Array, "N"],
    creates: Bool[Array, "N"],
    next_id: Int[Array, ""],
    t: Competition,
) -> Rivalry:
    """Finds new detections that score nearly as a matched detection does on its object.

    Args:
      table: Scores and gates of all pairs.
      objects: Objects known before the frame.
      slot: Matched object of each detection, -1 none.
      creates: Detections that would found an object.
      next_id: Next free object id.
      t: Thresholds.
    """
    num, width = table.pairs.eligible.shape
    known = table.pairs.score_known
    holds = slot[:, None] == jnp.arange(width)
    held = jnp.any(holds, axis=0)
    open_parents = table.comparison.candidate & held[None]
    parent = jnp.argmax(jnp.where(open_parents, known, -jnp.inf), axis=1)
    has_parent = jnp.any(open_parents, axis=1) & creates & t.enabled
    holder = jnp.argmax(holds, axis=0)[parent]

    at = lambda table: jnp.take_along_axis(table, parent[:, None], axis=1)[:, 0]  # noqa: E731
    lifecycle = objects.lifecycle[parent]
    young = (objects.age[parent] <= t.max_parent_age) | ~t.young_only
    is_confirmed = lifecycle == Lifecycle.CONFIRMED
    fit = jnp.where(is_confirmed, t.confirmed_parents, (lifecycle <= Lifecycle.TENTATIVE) & young)
    least = jnp.where(is_confirmed, t.confirmed_min_score, t.min_score)
    widest = jnp.where(is_confirmed, t.confirmed_max_gap, t.max_gap)
    blocked = at(table.plausible) & ~at(table.pairs.eligible)
    least = jnp.where(blocked, jnp.minimum(least, t.min_score), least)
    widest = jnp.where(blocked, jnp.maximum(widest, t.max_gap), widest)
    mine = at(known)
    theirs = known[holder, parent]
    ok = has_parent & fit & (mine >= least) & (theirs >= least)
    ok = ok & (jnp.abs(theirs - mine) <= widest)

    supported = table.plausible & table.context.supported[None]
    rival_score = jnp.maximum(known, temporal_score(table, supported))

    def has_rival(row: Int[Array, "N"]) -> Bool[Array, "N"]:
        """Another supported candidate of that detection is good enough as well."""
        among = supported[row]
        is_parent = parent[:, None] == jnp.arange(width)
        asked = (jnp.sum(table.plausible[row], axis=1) >= 2) & (jnp.sum(among, axis=1) >= 2)
        asked = asked & jnp.any(among & is_parent, axis=1)
        return asked & jnp.any(among & ~is_parent & (rival_score[row] >= least[:, None]), axis=1)

    ok = ok & ~has_rival(jnp.arange(num)) & ~has_rival(holder)
    claims = ok[:, None] & (parent[:, None] == jnp.arange(width))
    crowded = (jnp.sum(claims, axis=0) > 1) & t.single_create
    best = jnp.argmax(jnp.where(claims, mine[:, None], -jnp.inf), axis=0)
    seed = ok & ~crowded[parent] & (best[parent] == jnp.arange(num))

    score = jnp.maximum(mine, theirs)
    virtual = width + jnp.arange(num)
    pair = jnp.stack([parent, virtual, jnp.full(num, NO_SLOT)], axis=1).astype(jnp.int32)
    scores = jnp.stack([score, score, jnp.zeros_like(score)], axis=1)
    of_seed = jnp.where(seed, holder, num)

    def spread(values: Array) -> Array:
        """The founding detection and the one that holds the parent share the entry."""
        empty = jnp.zeros_like(values)
        own = jnp.where(seed.reshape(-1, *(1,) * (values.ndim - 1)), values, empty)
        return own.at[of_seed].set(values, mode="drop")

    present = seed.at[of_seed].set(True, mode="drop")
    entries = Undecided(
        present=present,
        slot=jnp.where(present[:, None], spread(pair), NO_SLOT),
        score=spread(scores),
        best=spread(score),
        reason=jnp.full(num, Reason.KNOWN_AND_COMMITTED_NEW_COMPETITION, jnp.int32),
    )
    return Rivalry(entries, reserve_ids(seed, parent, creates, next_id, width))
