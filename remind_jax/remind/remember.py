"""What memory learns from a frame: banks of seen objects, births, absences (paper III-F).

Order of operations: method.md#memory-order.

Letters: `N` detections, `O` objects, `P` pending tracks.
"""

from __future__ import annotations

import dataclasses

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Int

from remind_jax.decision import Decisions, Outcome, Overflow, Reason, Status
from remind_jax.numerics.absent import NO_ID
from remind_jax.numerics.control_flow import repeat
from remind_jax.numerics.pytree import choose
from remind_jax.numerics.ranks import rank_rising
from remind_jax.observation import Descriptors
from remind_jax.remind.memory.bank import Permit
from remind_jax.remind.memory.channels import CHANNELS
from remind_jax.remind.memory.cooccurrence import gather_sightings, update_cooccurrence
from remind_jax.remind.memory.distances import update_distances
from remind_jax.remind.memory.objects import Objects, create_objects, mark_missed, mark_seen
from remind_jax.remind.memory.pending import (
    Items,
    Kind,
    end_tracks,
    join_tracks,
    open_tracks,
    write_tracks,
)
from remind_jax.remind.memory.prototypes import Bank, keep_rows
from remind_jax.remind.memory.writing import write_rows
from remind_jax.remind.outcome import Intermediates
from remind_jax.remind.perception.description import DescribedFrame
from remind_jax.remind.stages import Lock, MatchOrigin, Stages
from remind_jax.remind.state import TrackerState, map_banks, remove_objects
from remind_jax.remind.thresholds import Thresholds
from remind_jax.remind.undecided.provisional_commit import (
    claim_origins,
    find_founders,
    found_reserved,
    support_births,
)
from remind_jax.remind.undecided.settlement import Settlement
from remind_jax.static import Static


def remember(
    state: TrackerState,
    seen: DescribedFrame,
    decisions: Decisions,
    made_of: Intermediates,
    static: Static,
    t: Thresholds,
) -> TrackerState:
    """Writes a frame into memory, and the ids of what is new into its decisions.

    If new objects or pending tracks do not fit, nothing is written but `overflow`.
    """
    descriptors, table = seen.descriptors, made_of.table
    stages, settlement = made_of.stages, made_of.settlement
    slots, num_pending = static.num_objects, static.num_pending
    now = state.frame
    is_new = decisions.outcome == Outcome.NEW

    support = support_births(table, state.objects, descriptors.class_id, is_new)
    support_id = state.objects.id_of(support)
    ended = claim_origins(state.pending, is_new, descriptors.class_id, support_id, t.pending)
    tracks = end_tracks(state.pending, ended)
    items = _undecided(decisions, settlement, seen, t)
    likeness = table.comparison.pending_score
    joined = join_tracks(tracks, items, likeness, t.pending, solver=static.solver)
    pending_slot, needed_pending = open_tracks(tracks, items, joined)

    num_new = jnp.sum(is_new, dtype=jnp.int32)
    founds = find_founders(settlement.reserved_id, items, state.next_id + num_new)
    births = num_new + jnp.sum(founds, dtype=jnp.int32)
    needed = jnp.sum(state.objects.exists, dtype=jnp.int32) + births
    fits = (needed <= slots) & (needed_pending <= num_pending)

    objects, new_slot = create_objects(
        state.objects, descriptors.class_id, is_new & fits, state.next_id
    )
    next_id = state.next_id + jnp.where(fits, num_new, 0)
    objects, founder_slot, next_id = found_reserved(
        objects, descriptors.class_id, founds & fits, settlement.reserved_id, next_id
    )
    slot = jnp.where(settlement.slot >= 0, settlement.slot, new_slot)
    slot = jnp.where(fits, slot, slots)
    sights = _count(jnp.stack([slot, founder_slot]), slots)
    objects = mark_seen(objects, sights, now, t.lifecycle)
    spared = (sights > 0) | _protected(objects, items)
    objects, forgotten = mark_missed(objects, objects.exists & ~spared & fits, t.lifecycle)

    in_track = items.kind != Kind.FREE
    pending_slot = jnp.where(fits & in_track, pending_slot, num_pending)
    written = write_tracks(tracks, items, pending_slot, joined)
    tracks = choose(fits, written, state.pending)
    decisions = dataclasses.replace(
        decisions,
        object_id=jnp.where(
            is_new, objects.id.at[slot].get(mode="fill", fill_value=NO_ID), decisions.object_id
        ),
        pending_id=tracks.id.at[pending_slot].get(mode="fill", fill_value=NO_ID),
    )
    # In the types of the state, so that one compiled program serves every frame.
    shown = jax.tree.map(
        lambda new, old: jnp.where(fits, new.astype(old.dtype), old), decisions, state.decisions
    )

    learns, permit = gate_updates(decisions, stages, t)
    row = jnp.where(pending_slot < num_pending, slots + pending_slot, slots + num_pending)
    row = jnp.where(slot < slots, slot, row)
    row = jnp.where(learns & descriptors.valid, row, slots + num_pending)
    founder_row = jnp.where(founder_slot < slots, founder_slot, slots + num_pending)
    allowed = ~t.update.gated | ((decisions.outcome == Outcome.MATCH) & learns & permit.insert)
    sightings = gather_sightings(
        jnp.where(descriptors.valid & t.cooccurrence.enabled, slot, slots),
        _decided_rank(decisions, stages, settlement.source, descriptors.class_id),
        allowed,
        slots,
    )
    cooccurrence, accepted = update_cooccurrence(
        state.cooccurrence, sightings, objects.id, now, static, t.cooccurrence
    )
    distances = update_distances(
        state.distances, made_of.relations, sightings, accepted, t.relations
    )
    kept = jnp.concatenate([jnp.ones(slots, bool), ~(ended & fits)])
    cleared = map_banks(state, lambda _, banks: keep_rows(banks, kept))
    updated = dataclasses.replace(
        _update_banks(cleared, jnp.stack([row, founder_row]), descriptors, permit, static, t),
        objects=objects,
        pending=tracks,
        cooccurrence=cooccurrence,
        distances=distances,
        next_id=next_id,
        frame=now + fits,
        decisions=shown,
        overflow=Overflow(
            objects=jnp.where(needed <= slots, 0, needed),
            pending=jnp.where(needed_pending <= num_pending, 0, needed_pending),
        ),
    )
    if static.switches.remove_objects:
        return remove_objects(updated, forgotten & fits)
    return updated


def _count(slot: Int[Array, "2 N"], slots: int) -> Int[Array, "O"]:
    return jnp.sum(slot[..., None] == jnp.arange(slots), axis=(0, 1), dtype=jnp.int32)


def _undecided(
    decisions: Decisions, settlement: Settlement, seen: DescribedFrame, t: Thresholds
) -> Items:
    """The detections that go to pending tracks."""
    doubts, outcome = settlement.doubts, decisions.outcome
    ambiguous = (outcome == Outcome.AMBIGUOUS) & t.pending.ambiguous_enabled
    provisional = (outcome == Outcome.PROVISIONAL_NEW) | (outcome == Outcome.PROVISIONAL_PARENT)
    provisional = provisional & t.pending.provisional_enabled
    kind = jnp.where(ambiguous, Kind.AMBIGUOUS, Kind.FREE)
    kind = jnp.where(provisional, Kind.PROVISIONAL, kind)
    return Items.begun(
        kind=kind.astype(jnp.int32),
        class_id=seen.descriptors.class_id,
        known_id=decisions.option_id,
        known_score=decisions.option_score,
        from_parent=doubts.reason == Reason.UNCERTAIN_PARENT,
        center=seen.masks.center,
        area=seen.masks.area,
    )


def _protected(objects: Objects, items: Items) -> Bool[Array, "O"]:
    """Objects that an undecided detection names: they count no miss (method.md#lifecycle)."""
    named = jnp.where((items.kind != Kind.FREE)[:, None], items.known_id, NO_ID)
    return objects.exists & jnp.any(objects.id[:, None, None] == named, axis=(1, 2))


def _decided_rank(
    decisions: Decisions, stages: Stages, source: Int[Array, "N"], class_id: Int[Array, "N"]
) -> Int[Array, "N"]:
    """Position of every detection in the order in which it got its object.

    Matches come before births; among the matches those of the assignment, class by class as
    the classes appear, locks first (method.md#locks, method.md#outcomes).
    """
    late = (source > MatchOrigin.ASSOCIATION).astype(jnp.int32)
    late = jnp.where(decisions.outcome == Outcome.NEW, 2, late)
    by_class = jnp.argmax(class_id[:, None] == class_id, axis=1)
    by_class = jnp.where(late == 0, by_class, 0)
    locked = (stages.lock != Lock.NONE) & (late == 0)
    lock = jnp.where(locked, stages.lock, Lock.DETECTION + 1)
    assigned = decisions.candidate_id == stages.assigned_id[:, None]
    score = jnp.sum(jnp.where(assigned, decisions.candidate_score, 0.0), axis=1)
    return rank_rising([late, by_class, lock, -jnp.where(locked, score, 0.0)])


def gate_updates(
    decisions: Decisions, stages: Stages, t: Thresholds
) -> tuple[Bool[Array, "N"], Permit]:
    """How freely each detection changes memory; new ones always may (method.md#update-permit)."""
    status = stages.status_final
    gated = t.update.gated & (decisions.outcome == Outcome.MATCH)
    weak, ambiguous = status == Status.WEAK, status == Status.AMBIGUOUS
    rate = jnp.where(gated & ambiguous, t.update.ambiguous_rate, 1.0)
    return ~(gated & weak), Permit(insert=~(gated & ambiguous), rate=rate)


def _update_banks(
    state: TrackerState,
    rows: Int[Array, "2 N"],
    descriptors: Descriptors,
    permit: Permit,
    static: Static,
    t: Thresholds,
) -> TrackerState:
    """Shows each detection to the banks of its object or pending track, and of what it founds.

    A detection may have two targets, and an object two detections; such cases take further rounds.
    """
    none = state.wholes.size.shape[2]
    now, num = state.frame, rows.shape[1]
    kinds = {name: getattr(state, name) for name in CHANNELS if getattr(state, name) is not None}

    def show(carry: tuple[Array, dict[str, Bank]]) -> tuple[Array, dict[str, Bank]]:
        rows, kinds = carry
        turn = jnp.where(rows[0] < none, rows[0], rows[1])
        first = jnp.argmax(turn[:, None] == turn[None], axis=1) == jnp.arange(num)
        turn = jnp.where(first, turn, none)
        done = (rows == turn) & (rows < none)
        done = done & jnp.stack([jnp.ones(num, bool), ~done[0]])
        at = jnp.minimum(turn, none - 1)
        seen = {
            name: CHANNELS[name](banks, descriptors, permit, now, static, t)
            for name, banks in jax.tree.map(lambda leaf: leaf[:, :, at], kinds).items()
        }
        return jnp.where(done, none, rows), write_rows(kinds, turn, seen, axis=2)

    _, kinds = repeat(lambda carry: jnp.any(carry[0] < none), show, (rows, kinds))
    return dataclasses.replace(state, **kinds)
