"""What memory learns from a frame: banks of seen objects, births, absences (paper III-F).

Order of operations: perception notes 16. Letters: `N` detections, `O` objects.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Int

from remind_jax.config.static import Static
from remind_jax.config.thresholds import Thresholds
from remind_jax.decision import NO_ID, Decisions, Outcome, Status
from remind_jax.memory.appearance import appearance_quality, observe_appearance
from remind_jax.memory.background import observe_background, ring_quality
from remind_jax.memory.bank import DualBank, Permit, Room, place
from remind_jax.memory.lifecycle import create_objects, mark_missed, mark_seen, remove_objects
from remind_jax.memory.parts import observe_part
from remind_jax.observation import Descriptors
from remind_jax.state import Overflow, TrackerState


def remember(
    state: TrackerState,
    decisions: Decisions,
    slot: Int[Array, "N"],
    descriptors: Descriptors,
    static: Static,
    t: Thresholds,
) -> TrackerState:
    """Writes the outcome of a frame into memory.

    If the new objects do not fit, nothing is written but `overflow`.

    Args:
      state: Memory before the frame.
      decisions: Outcomes; ids of new objects are filled in here.
      slot: Object slot of matched detections, -1 otherwise.
      descriptors: What the detections look like.
      static: Capacities and policies.
      t: Thresholds.
    """
    slots = state.objects.id.shape[0]
    is_new = decisions.outcome == Outcome.NEW
    needed = jnp.sum(state.objects.exists, dtype=jnp.int32) + jnp.sum(is_new, dtype=jnp.int32)
    fits = needed <= slots
    now = state.frame

    objects, new_slot = create_objects(
        state.objects, descriptors.class_id, is_new & fits, state.next_id
    )
    rows = jnp.where(slot >= 0, slot, new_slot)
    rows = jnp.where(fits & descriptors.valid, rows, slots)
    seen = jnp.zeros(slots, bool).at[rows].set(True, mode="drop")
    objects = mark_seen(objects, seen, now, t.lifecycle)
    objects, forgotten = mark_missed(objects, objects.exists & ~seen & fits, t.lifecycle)

    object_id = objects.id.at[rows].get(mode="fill", fill_value=NO_ID)
    decisions = dataclasses.replace(
        decisions, object_id=jnp.where(is_new, object_id, decisions.object_id)
    )
    learns, permit = gate_updates(decisions, t)
    rows = jnp.where(learns, rows, slots)
    updated = dataclasses.replace(
        _update_banks(state, rows, descriptors, permit, static, t),
        objects=objects,
        next_id=state.next_id + jnp.where(fits, jnp.sum(is_new, dtype=jnp.int32), 0),
        frame=now + fits,
        decisions=decisions,
        overflow=Overflow(objects=jnp.where(fits, 0, needed)),
    )
    if static.remove_objects:
        return remove_objects(updated, forgotten & fits)
    return updated


def gate_updates(decisions: Decisions, t: Thresholds) -> tuple[Bool[Array, "N"], Permit]:
    """How freely each detection may change memory (notes 13); new objects always may."""
    status = decisions.status_final
    gated = t.update.gated & (decisions.outcome == Outcome.MATCH)
    weak, ambiguous = status == Status.WEAK, status == Status.AMBIGUOUS
    rate = jnp.where(gated & ambiguous, t.update.ambiguous_rate, 1.0)
    return ~(gated & weak), Permit(insert=~(gated & ambiguous), rate=rate)


def _update_banks(
    state: TrackerState,
    rows: Int[Array, "N"],
    descriptors: Descriptors,
    permit: Permit,
    static: Static,
    t: Thresholds,
) -> TrackerState:
    """Shows each detection to the banks of its object; `rows` beyond the slots are dropped."""
    return dataclasses.replace(
        state,
        appearance=_write_rows(
            state.appearance,
            rows,
            lambda banks: _observe_appearance(banks, descriptors, permit, state.frame, static, t),
        ),
        rings=_write_rows(
            state.rings,
            rows,
            lambda banks: _observe_rings(banks, descriptors, permit, state.frame, static, t),
        ),
        parts=_write_rows(
            state.parts,
            rows,
            lambda banks: _observe_parts(banks, descriptors, permit, state.frame, static, t),
        ),
    )


def _write_rows(
    banks: DualBank, rows: Int[Array, "N"], observe: Callable[[DualBank], DualBank]
) -> DualBank:
    """Applies `observe` to the banks of the detections' objects, leading axes `[C N]`."""
    last = banks.work.size.shape[1] - 1
    picked = jax.tree.map(lambda leaf: leaf[:, jnp.minimum(rows, last)], banks)
    updated = observe(picked)
    return jax.tree.map(lambda leaf, new: leaf.at[:, rows].set(new, mode="drop"), banks, updated)


def _observe_appearance(
    banks: DualBank,
    d: Descriptors,
    permit: Permit,
    now: Int[Array, ""],
    static: Static,
    t: Thresholds,
) -> DualBank:
    observe = functools.partial(observe_appearance, now=now, static=static, t=t.appearance)
    quality = appearance_quality(d.patch_sum, t.appearance)
    over_detections = jax.vmap(observe)
    banks, arrival = jax.vmap(over_detections, in_axes=(0, 1, 1, 1, None))(
        banks, d.appearance, d.appearance_valid, quality, permit
    )
    room = Room(
        capacity=jnp.array([static.appearance_slots] * 2),
        merge=jnp.stack([t.appearance.merge, t.appearance.stable_merge]),
        redundant=jnp.array(
            [
                static.appearance_evict == "redundant",
                static.appearance_stable_evict == "redundant",
            ]
        ),
        cap=t.appearance.merge_cap if static.appearance_merge == "capped" else None,
    )
    return place(banks, arrival, room, now)


def _observe_rings(
    banks: DualBank,
    d: Descriptors,
    permit: Permit,
    now: Int[Array, ""],
    static: Static,
    t: Thresholds,
) -> DualBank:
    observe = functools.partial(observe_background, now=now, t=t.background)
    quality = ring_quality(d.ring_patches, d.mask_quality, t.background)
    capacity = jnp.array([static.inner_ring_slots, static.outer_ring_slots])
    over_detections = jax.vmap(observe, in_axes=(0, 0, 0, 0, 0, None))
    banks, arrival = jax.vmap(over_detections, in_axes=(0, 1, 1, 1, None, 0))(
        banks, d.rings, d.rings_valid & t.background.enabled, quality, permit, capacity[:, 1]
    )
    room = Room(
        capacity=capacity,
        merge=jnp.stack([t.background.merge] * 2),
        redundant=jnp.array([static.ring_evict == "redundant"] * 2),
        cap=t.background.merge_cap,
    )
    return place(banks, arrival, room, now)


def _observe_parts(
    banks: DualBank,
    d: Descriptors,
    permit: Permit,
    now: Int[Array, ""],
    static: Static,
    t: Thresholds,
) -> DualBank:
    """Parts of one detection arrive one after another, those of all detections together."""
    observe = functools.partial(observe_part, now=now, static=static, t=t.parts)
    over_detections = jax.vmap(observe)
    over_channels = jax.vmap(over_detections, in_axes=(0, 0, 1, 1, None))
    room = Room(
        capacity=jnp.array([static.part_slots] * banks.work.size.shape[0]),
        merge=jnp.stack([t.parts.merge, t.parts.stable_merge]),
        redundant=jnp.array([static.part_evict == "redundant"] * 2),
        cap=t.parts.merge_cap if static.part_merge == "capped" else None,
    )

    def show(carry: tuple[DualBank, Array], part: tuple[Array, Array]):
        banks, used, arrival = over_channels(*carry, *part, permit)
        return (place(banks, arrival, room, now), used), None

    used = jnp.zeros(banks.work.hits.shape, bool)
    parts = (jnp.moveaxis(d.parts, 2, 0), jnp.moveaxis(d.parts_valid, 2, 0))
    (banks, _), _ = jax.lax.scan(show, (banks, used), parts)
    return banks
