"""The whole memory of a tracker as one fixed-capacity pytree.

Letters: `O` object slots, `P` slots of pending tracks, `A` appearance channels (global, trimmed),
`C` part channels, `R` rings (inner, outer). Object slots in use come first and are ordered by
rising id; ids, never slots, are shown outside.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Int

from remind_jax.decision import Decisions, Overflow, no_decisions
from remind_jax.errors import ConfigError
from remind_jax.method import extend
from remind_jax.numerics.absent import NEVER, NO_ID
from remind_jax.numerics.constant_arrays import full, number
from remind_jax.numerics.pytree import pytree
from remind_jax.remind.memory.cooccurrence import (
    CooccurrenceGraph,
    empty_cooccurrence,
    reorder_cooccurrence,
)
from remind_jax.remind.memory.distances import DistanceGraph, empty_distances, reorder_distances
from remind_jax.remind.memory.objects import Lifecycle, Objects
from remind_jax.remind.memory.pending import Kind, PendingTracks, no_pending
from remind_jax.remind.memory.prototypes import Bank, empty_bank, keep_rows
from remind_jax.static import Static

NUM_APPEARANCE_CHANNELS = 2
NUM_RINGS = 2
BANKS = ("wholes", "parts", "ring_prototypes")


@pytree
class TrackerState:
    """Everything that one frame hands to the next, and the decisions of the last frame."""

    objects: Objects
    pending: PendingTracks
    cooccurrence: CooccurrenceGraph  # who is seen with whom
    distances: DistanceGraph  # and how far apart
    # Work and stable banks, leading axes [2 C O+P]: objects first, then pending tracks.
    wholes: Bank  # what a detection has one vector of: the appearance channels, then the rings
    parts: Bank
    ring_prototypes: Bank | None  # of the rings, only with static.ring_prototypes
    next_id: Int[Array, ""]  # id of the next new object
    frame: Int[Array, ""]  # frames processed so far, the clock of the memory
    decisions: Decisions
    overflow: Overflow

    @property
    def appearance(self) -> Bank:
        """The banks of the appearance channels, leading axes `[2 A O+P]`."""
        return jax.tree.map(lambda leaf: leaf[:, :NUM_APPEARANCE_CHANNELS], self.wholes)

    @property
    def rings(self) -> Bank:
        """The banks of the rings, leading axes `[2 R O+P]`."""
        return jax.tree.map(lambda leaf: leaf[:, NUM_APPEARANCE_CHANNELS:], self.wholes)


def init(static: Static) -> TrackerState:
    """The empty memory with the capacities of `static`. Raises ConfigError if it is no `Static`."""
    if not isinstance(static, Static):
        raise ConfigError(f"static is of type {type(static).__name__}; give a remind_jax.Static")
    s, objects, scalar = static.switches, static.num_objects, static.scalar

    def banks(channels: int, *capacities: tuple[int, int]) -> Bank:
        """All banks of a kind share one shape; capacities are kept by the updates."""
        slots, rows = max(map(max, capacities)), objects + static.num_pending
        return empty_bank((2, channels, rows), slots, static.feature_dim, scalar)

    def column(value: int) -> Array:
        return full(objects, int(value), np.int32)

    all_of_whole = s.appearance_slots, s.inner_ring_slots, s.outer_ring_slots
    of_patches = s.inner_prototype_slots, s.outer_prototype_slots
    empty = TrackerState(
        objects=Objects(
            id=column(NO_ID),
            class_id=column(NO_ID),
            lifecycle=column(Lifecycle.NEW),
            hits=column(0),
            misses=column(0),
            age=column(0),
            last_seen=column(NEVER),
        ),
        pending=no_pending(static.num_pending, scalar),
        cooccurrence=empty_cooccurrence(objects, scalar),
        distances=empty_distances(objects, scalar, s.pending_relations),
        wholes=banks(NUM_APPEARANCE_CHANNELS + NUM_RINGS, *all_of_whole),
        parts=banks(len(s.part_channels), s.part_slots),
        ring_prototypes=banks(NUM_RINGS, *of_patches) if s.ring_prototypes else None,
        next_id=number(static.first_object_id),
        frame=number(0),
        decisions=no_decisions(static),
        overflow=Overflow(objects=number(0), pending=number(0)),
    )
    return jax.device_put(empty)


def grow(state: TrackerState, empty: TrackerState) -> TrackerState:
    """A memory moved into the arrays of a larger, empty one, on the host."""
    old_objects, new_objects = state.objects.id.shape[0], empty.objects.id.shape[0]

    def fill_rows(small: np.ndarray, large: np.ndarray) -> np.ndarray:
        """Rows of objects and rows of pending tracks move apart."""
        pending = small[:, :, old_objects:]
        large[:, :, :old_objects] = small[:, :, :old_objects]
        large[:, :, new_objects : new_objects + pending.shape[2]] = pending
        return large

    def fill(name: str, banks: Bank) -> Bank:
        return jax.tree.map(fill_rows, banks, getattr(empty, name))

    return extend(map_banks(state, fill), empty)


def map_banks(state: TrackerState, function: Callable[[str, Bank], Bank]) -> TrackerState:
    """Applies a function of name and banks to the banks of every kind that there is."""
    names = [name for name in BANKS if getattr(state, name) is not None]
    changed = {name: function(name, getattr(state, name)) for name in names}
    return dataclasses.replace(state, **changed)


def count_occupied(state: TrackerState) -> tuple[Int[Array, ""], Int[Array, ""]]:
    """Slots of objects and of pending tracks that are in use."""
    return jnp.sum(state.objects.exists), jnp.sum(state.pending.kind != Kind.FREE)


def remove_objects(state: TrackerState, forgotten: Bool[Array, "O"]) -> TrackerState:
    """Takes objects out of memory and closes the gaps, so that slots stay ordered by id."""
    keep = state.objects.exists & ~forgotten
    slots, num_pending = keep.shape[0], state.pending.id.shape[0]
    order = jnp.argsort(~keep, stable=True).astype(jnp.int32)
    alive = jnp.arange(slots) < jnp.sum(keep)
    rows = jnp.concatenate([order, slots + jnp.arange(num_pending, dtype=jnp.int32)])
    filled = jnp.concatenate([alive, jnp.ones(num_pending, bool)])
    kept = jax.tree.map(lambda leaf: leaf[order], state.objects)
    ids = {name: jnp.where(alive, getattr(kept, name), NO_ID) for name in ("id", "class_id")}

    def compact(_: str, banks: Bank) -> Bank:
        return keep_rows(jax.tree.map(lambda leaf: leaf[:, :, rows], banks), filled)

    compacted = map_banks(state, compact)
    return dataclasses.replace(
        compacted,
        objects=dataclasses.replace(kept, **ids),
        cooccurrence=reorder_cooccurrence(state.cooccurrence, order, alive),
        distances=reorder_distances(state.distances, order, alive),
    )
