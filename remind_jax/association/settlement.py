"""Who stays undecided? Guards after the assignment and their reconciliation (notes 14 to 17)."""

from __future__ import annotations

import dataclasses

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from remind_jax.association.ambiguity import find_ambiguous
from remind_jax.association.assignment import Assignment
from remind_jax.association.competition import find_competitions
from remind_jax.association.provisional import Doubts, question_births
from remind_jax.association.stability import doubt_entries, stabilise
from remind_jax.association.temporal import NO_SLOT, Account, Entries, prefer
from remind_jax.config.static import Static
from remind_jax.config.thresholds import Thresholds
from remind_jax.decision import Source
from remind_jax.state import Objects


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Settlement:
    """The verdict on every detection; ambiguous and provisional outrank matched and new."""

    slot: Int[Array, "N"]  # matched object, -1 none
    score: Float[Array, "N"]  # of the match
    source: Int[Array, "N"]  # decision.Source of the match
    guarded: Int[Array, "N"]  # matched object after the guard of look-alikes
    creates: Bool[Array, "N"]  # founds an object unless it is ambiguous or provisional
    ambiguous: Entries
    doubts: Doubts
    reserved_id: Int[Array, "N"]  # id of the object that an ambiguous detection founds, -1 none


def settle(
    account: Account,
    assignment: Assignment,
    objects: Objects,
    usable: Bool[Array, "N"],
    next_id: Int[Array, ""],
    static: Static,
    t: Thresholds,
) -> Settlement:
    """Withdraws what is too close to call and asks again of what would be new.

    Args:
      account: Scores and gates of all pairs.
      assignment: Result of the joint assignment.
      objects: Objects known before the frame.
      usable: Detections that can be decided about.
      next_id: Next free object id.
      static: Number of passes.
      t: Thresholds.
    """
    width = account.plausible.shape[1]
    stable = stabilise(account, assignment.slot, t.stability)
    slot = stable.slot
    creates = usable & (slot < 0)
    doubtful = doubt_entries(account, stable, t.matching.min_visual, t.ambiguous.max_candidates)
    creates = creates & ~doubtful.present
    rivalry = find_competitions(account, objects, slot, creates, next_id, t.competition)
    policy = find_ambiguous(account, slot, creates, t.ambiguous)
    entries = prefer(rivalry.entries, prefer(doubtful, policy))

    score = jnp.take_along_axis(account.pairs.score_final, jnp.maximum(slot, 0)[:, None], axis=1)
    score = jnp.where(slot >= 0, score[:, 0], 0.0)
    source = jnp.where(slot >= 0, Source.ASSOCIATION, Source.NONE)
    for _ in range(static.max_passes):
        held = jnp.any(slot[:, None] == jnp.arange(width), axis=0)
        doubts = question_births(
            account, creates & ~entries.present, held, t.ambiguous.max_candidates, t.provisional,
            t.matching, t.diagnosis,
        )  # fmt: skip
        entries = prefer(entries, doubts.ambiguous)
    return Settlement(
        slot=jnp.where(entries.present | doubts.present, NO_SLOT, slot),
        score=score,
        source=source,
        guarded=stable.slot,
        creates=creates & ~entries.present & ~doubts.present & (slot < 0),
        ambiguous=entries,
        doubts=doubts,
        reserved_id=rivalry.reserved_id,
    )
