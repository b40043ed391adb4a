"""Who stays undecided? Guards after the assignment and their reconciliation.

Rules: method.md#settlement-rounds, method.md#entry-priority.
"""

from __future__ import annotations

import dataclasses

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from remind_jax.numerics.absent import NO_SLOT
from remind_jax.numerics.pytree import pytree
from remind_jax.numerics.reductions import pick_in_rows
from remind_jax.observation import Descriptors
from remind_jax.remind.association.assignment import Assignment
from remind_jax.remind.disambiguation.groups import Undecided
from remind_jax.remind.disambiguation.known_sets import Settled, settle_known_sets
from remind_jax.remind.perception.relations import Relations
from remind_jax.remind.stages import MatchOrigin
from remind_jax.remind.state import TrackerState
from remind_jax.remind.undecided.ambiguity import find_ambiguous
from remind_jax.remind.undecided.competition import find_competitions, withdraw_second_claims
from remind_jax.remind.undecided.provisional import Doubts, no_doubts, question_births
from remind_jax.remind.undecided.stability import Stabilized, doubt_entries, stabilize
from remind_jax.remind.undecided.temporal import PairTable, prefer
from remind_jax.static import Static


@pytree
class Settlement:
    """The verdict on every detection; ambiguous and provisional outrank matched and new."""

    slot: Int[Array, "N"]  # matched object, -1 none
    score: Float[Array, "N"]  # of the match
    source: Int[Array, "N"]  # stages.MatchOrigin of the match
    creates: Bool[Array, "N"]  # founds an object unless it is ambiguous or provisional
    ambiguous: Undecided
    doubts: Doubts
    reserved_id: Int[Array, "N"]  # id of the object that an ambiguous detection founds, -1 none
    asked: Undecided  # undecided at the start of each pass, leading axis: passes
    answers: Settled  # what the layout made of them, likewise
    stabilized: Stabilized  # what the guard of look-alikes saw, and the matches that it left


def settle(
    table: PairTable,
    assignment: Assignment,
    state: TrackerState,
    descriptors: Descriptors,
    relations: Relations,
    static: Static,
) -> Settlement:
    """Withdraws what is too close to call, lets layout decide, and asks again of what is new."""
    exists = state.objects.exists  # looked up here, not in every pass
    stable = stabilize(table, assignment.slot)
    slot = stable.slot
    creates = descriptors.valid & (slot < 0)
    doubtful = doubt_entries(table, stable)
    creates = creates & ~doubtful.present
    rivals, reserved_id = find_competitions(table, state.objects, slot, creates, state.next_id)
    policy = find_ambiguous(table, slot, creates)
    entries = prefer(rivals, prefer(doubtful, policy))

    (score,) = pick_in_rows(slot, table.pairs.score_final)
    open_ = _Open(
        slot=slot,
        score=score,
        source=jnp.where(slot >= 0, MatchOrigin.ASSOCIATION, MatchOrigin.NONE).astype(jnp.int32),
        turn=jnp.zeros_like(slot),
        creates=creates,
        entries=entries,
        doubts=no_doubts(entries),
    )

    def reconcile(open_: _Open, turn: Int[Array, ""]) -> tuple[_Open, tuple[Undecided, Settled]]:
        settled = settle_known_sets(
            open_.entries, descriptors.class_id, open_.slot, open_.turn, table.comparison.candidate,
            table.pairs, exists, relations, state.distances, static, table.thresholds.known_sets,
        )  # fmt: skip
        return _follow_layout(open_, settled, turn, table), (open_.entries, settled)

    turns = jnp.arange(static.switches.max_passes, dtype=jnp.int32)
    open_, (asked, answers) = jax.lax.scan(reconcile, open_, turns)
    undecided = open_.entries.present | open_.doubts.present
    claimed = jnp.where(undecided, NO_SLOT, open_.slot)
    second = withdraw_second_claims(table, claimed, open_.score)
    entries = prefer(open_.entries, second)
    undecided = undecided | second.present
    return Settlement(
        slot=jnp.where(undecided, NO_SLOT, open_.slot),
        score=open_.score,
        source=open_.source,
        creates=open_.creates & ~undecided & (open_.slot < 0),
        ambiguous=entries,
        doubts=open_.doubts,
        reserved_id=reserved_id,
        asked=asked,
        answers=answers,
        stabilized=stable,
    )


@pytree
class _Open:
    """What the passes of the reconciliation hand on."""

    slot: Int[Array, "N"]
    score: Float[Array, "N"]
    source: Int[Array, "N"]
    turn: Int[Array, "N"]  # pass that made the match, 0 for the assignment
    creates: Bool[Array, "N"]
    entries: Undecided
    doubts: Doubts


def _follow_layout(open_: _Open, settled: Settled, turn: Int[Array, ""], table: PairTable) -> _Open:
    """Takes over what layout settled and questions births again (method.md#settlement-rounds)."""
    found = settled.resolved_slot >= 0
    late = MatchOrigin.DISTANCE_FULL_POSTCREATE - MatchOrigin.DISTANCE_FULL
    by_layout = settled.source + jnp.where(turn > 0, late, 0)
    slot = jnp.where(found, settled.resolved_slot, open_.slot)
    creates = open_.creates & ~found
    entries = dataclasses.replace(open_.entries, present=settled.remaining)

    held = jnp.any(slot[:, None] == jnp.arange(table.plausible.shape[1]), axis=0)
    doubts = question_births(table, creates & ~entries.present, held)
    return _Open(
        slot=slot,
        score=jnp.where(found, settled.resolved_score, open_.score),
        source=jnp.where(found, by_layout, open_.source).astype(jnp.int32),
        turn=jnp.where(found, turn + 1, open_.turn),
        creates=creates,
        entries=prefer(entries, doubts.ambiguous),
        doubts=doubts,
    )
