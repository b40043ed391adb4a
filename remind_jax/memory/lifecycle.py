"""Birth, confirmation, absence and removal of objects (paper III-F; perception notes 14)."""

from __future__ import annotations

import dataclasses

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Int

from remind_jax.config.thresholds import Lifecycle as Rules
from remind_jax.decision import NO_ID
from remind_jax.memory.bank import DualBank
from remind_jax.memory.cooccurrence import reorder_cooccurrence
from remind_jax.memory.distances import reorder_distances
from remind_jax.state import Lifecycle, Objects, TrackerState


def create_objects(
    objects: Objects,
    class_id: Int[Array, "N"],
    is_new: Bool[Array, "N"],
    next_id: Int[Array, ""],
) -> tuple[Objects, Int[Array, "N"]]:
    """Gives each new detection the next free slot and id, in detection order.

    Returns:
      The objects, and the slot of each detection (`O` for detections that are not new).
    """
    slots = objects.id.shape[0]
    rank = jnp.cumsum(is_new, dtype=jnp.int32) - 1
    slot = jnp.where(is_new, jnp.sum(objects.exists, dtype=jnp.int32) + rank, slots)

    def put(column: Array, value: Array | int) -> Array:
        return column.at[slot].set(value, mode="drop")

    born = Objects(
        id=put(objects.id, next_id + rank),
        class_id=put(objects.class_id, class_id),
        lifecycle=put(objects.lifecycle, Lifecycle.NEW),
        hits=put(objects.hits, 0),
        misses=put(objects.misses, 0),
        age=put(objects.age, 0),
        last_seen=put(objects.last_seen, 0),
    )
    return born, slot


def mark_seen(
    objects: Objects, sights: Int[Array, "O"], now: Int[Array, ""], rules: Rules
) -> Objects:
    """Counts the detections that show an object; two in all confirm it (notes 14.1).

    Where one frame gives an object to two detections, each is a hit and a frame of its age.
    """
    seen = sights > 0
    hits = objects.hits + sights
    fresh = objects.lifecycle <= Lifecycle.TENTATIVE
    waits = fresh & (hits < rules.confirm_hits)
    lifecycle = jnp.where(waits, Lifecycle.TENTATIVE, Lifecycle.CONFIRMED)
    return dataclasses.replace(
        objects,
        lifecycle=jnp.where(seen, lifecycle, objects.lifecycle),
        hits=hits,
        misses=jnp.where(seen, 0, objects.misses),
        age=objects.age + sights,
        last_seen=jnp.where(seen, now, objects.last_seen),
    )


def mark_missed(
    objects: Objects, missed: Bool[Array, "O"], rules: Rules
) -> tuple[Objects, Bool[Array, "O"]]:
    """Counts a frame of absence (notes 14.2).

    Returns:
      The objects, and which of them stayed away so long that they may be forgotten.
    """
    misses = objects.misses + missed
    young = missed & (objects.lifecycle <= Lifecycle.TENTATIVE)
    confirmed = missed & (objects.lifecycle == Lifecycle.CONFIRMED)
    inactive = missed & (objects.lifecycle == Lifecycle.INACTIVE)

    def too_long(limit: Int[Array, ""]) -> Bool[Array, "O"]:
        return (limit > 0) & (misses >= limit)

    lifecycle = jnp.where(young, Lifecycle.TENTATIVE, objects.lifecycle)
    leaves = confirmed & too_long(rules.max_misses_confirmed)
    lifecycle = jnp.where(leaves, Lifecycle.INACTIVE, lifecycle)
    forgotten = (young & too_long(rules.max_misses_tentative)) | (
        inactive & too_long(rules.max_misses_inactive)
    )
    counted = dataclasses.replace(
        objects, lifecycle=lifecycle, misses=misses, age=objects.age + missed
    )
    return counted, forgotten


def remove_objects(state: TrackerState, forgotten: Bool[Array, "O"]) -> TrackerState:
    """Takes objects out of memory and closes the gaps, so that slots stay ordered by id."""
    keep = state.objects.exists & ~forgotten
    slots, num_pending = keep.shape[0], state.pending.id.shape[0]
    order = jnp.argsort(~keep, stable=True).astype(jnp.int32)
    alive = jnp.arange(slots) < jnp.sum(keep)
    rows = jnp.concatenate([order, slots + jnp.arange(num_pending, dtype=jnp.int32)])
    filled = jnp.concatenate([alive, jnp.ones(num_pending, bool)])
    kept = jax.tree.map(lambda leaf: leaf[order], state.objects)
    objects = dataclasses.replace(
        kept,
        id=jnp.where(alive, kept.id, NO_ID),
        class_id=jnp.where(alive, kept.class_id, NO_ID),
    )

    def compact(banks: DualBank | None) -> DualBank | None:
        if banks is None:
            return None
        moved = jax.tree.map(lambda leaf: leaf[:, rows], banks)
        clear = lambda bank: dataclasses.replace(bank, size=jnp.where(filled, bank.size, 0))  # noqa: E731
        return DualBank(clear(moved.work), clear(moved.stable))

    return dataclasses.replace(
        state,
        objects=objects,
        cooccurrence=reorder_cooccurrence(state.cooccurrence, order, alive),
        distances=reorder_distances(state.distances, order, alive),
        appearance=compact(state.appearance),
        parts=compact(state.parts),
        rings=compact(state.rings),
        ring_prototypes=compact(state.ring_prototypes),
    )
