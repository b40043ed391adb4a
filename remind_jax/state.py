"""The whole memory of a tracker as one fixed-capacity pytree.

Letters: `O` object slots, `P` slots of pending tracks, `A` appearance channels (global, trimmed),
`C` part channels, `R` rings (inner, outer). Object slots in use come first and are ordered by
rising id; ids, never slots, are shown outside.
"""

from __future__ import annotations

import dataclasses
import enum

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Int

from remind_jax.config.static import Static
from remind_jax.constant_arrays import full, number, zeros
from remind_jax.decision import NO_ID, NUM_OPTIONS, Decisions, Outcome
from remind_jax.memory.bank import NEVER, DualBank, empty_bank
from remind_jax.memory.cooccurrence import CooccurrenceGraph, empty_cooccurrence
from remind_jax.memory.distances import DistanceGraph, empty_distances
from remind_jax.memory.pending import Kind, PendingTracks, no_pending
from remind_jax.methods import extend

NUM_APPEARANCE_CHANNELS = 2
NUM_RINGS = 2


class Lifecycle(enum.IntEnum):
    """Standing of an object (perception notes 14)."""

    NEW = 0
    TENTATIVE = 1
    CONFIRMED = 2
    INACTIVE = 3


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Objects:
    """One row per remembered object."""

    id: Int[Array, "O"]  # -1 in free slots
    class_id: Int[Array, "O"]
    lifecycle: Int[Array, "O"]  # Lifecycle
    hits: Int[Array, "O"]  # frames in which it was seen
    misses: Int[Array, "O"]  # frames since it was last seen
    age: Int[Array, "O"]  # frames since it was created, the first included
    last_seen: Int[Array, "O"]  # frame

    @property
    def exists(self) -> Bool[Array, "O"]:
        """Slots in use."""
        return self.id != NO_ID


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Overflow:
    """What did not fit. A frame that overflows changes nothing else in the state."""

    objects: Int[Array, ""]  # object slots that the frame needs, 0 if they sufficed
    pending: Int[Array, ""]  # slots of pending tracks that it needs, 0 if they sufficed


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class TrackerState:
    """Everything that one frame hands to the next, and the decisions of the last frame."""

    objects: Objects
    pending: PendingTracks
    cooccurrence: CooccurrenceGraph  # who is seen with whom
    distances: DistanceGraph  # and how far apart
    appearance: DualBank  # leading axes [A O+P]: objects first, then pending tracks
    parts: DualBank  # leading axes [C O+P]
    rings: DualBank  # leading axes [R O+P]
    ring_prototypes: DualBank | None  # the same, only with static.ring_prototypes
    next_id: Int[Array, ""]  # id of the next new object
    frame: Int[Array, ""]  # frames processed so far, the clock of the memory
    decisions: Decisions
    overflow: Overflow


def init(static: Static) -> TrackerState:
    """The empty memory with the capacities of `static`."""
    objects, scalar, dim = static.num_objects, static.scalar, static.feature_dim

    def banks(channels: int, *capacities: tuple[int, int]) -> DualBank:
        """All banks of a kind share one shape; capacities are kept by the updates."""
        slots = max(max(capacity) for capacity in capacities)
        leading = (channels, objects + static.num_pending)
        work, stable = (empty_bank(leading, slots, dim, scalar) for _ in range(2))
        return DualBank(work, stable)

    def column(value: int) -> Array:
        return full(objects, int(value), np.int32)

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
        distances=empty_distances(objects, scalar, static.pending_relations),
        appearance=banks(NUM_APPEARANCE_CHANNELS, static.appearance_slots),
        parts=banks(len(static.part_channels), static.part_slots),
        rings=banks(NUM_RINGS, static.inner_ring_slots, static.outer_ring_slots),
        ring_prototypes=(
            banks(NUM_RINGS, static.inner_prototype_slots, static.outer_prototype_slots)
            if static.ring_prototypes
            else None
        ),
        next_id=number(static.first_object_id),
        frame=number(0),
        decisions=no_decisions(static),
        overflow=Overflow(objects=number(0), pending=number(0)),
    )
    return jax.device_put(empty)


def no_decisions(static: Static) -> Decisions:
    """Decisions about no detection at all."""
    num, shown, scalar = static.num_detections, static.num_candidates, static.scalar

    def whole(value: int) -> Array:
        return full(num, int(value), np.int32)

    def real() -> Array:
        """A new array at each call: buffers are donated to the step, each only once."""
        return zeros(num, scalar)

    return Decisions(
        outcome=whole(Outcome.EMPTY),
        reason=whole(0),
        object_id=whole(NO_ID),
        pending_id=whole(NO_ID),
        score=real(),
        status=whole(0),
        status_final=whole(0),
        confidence=real(),
        best_score=real(),
        second_score=real(),
        num_close=whole(0),
        lock=whole(0),
        source=whole(0),
        assigned_id=whole(NO_ID),
        guarded_id=whole(NO_ID),
        is_anchor=zeros(num, bool),
        option_id=full((num, NUM_OPTIONS), NO_ID, np.int32),
        option_score=zeros((num, NUM_OPTIONS), scalar),
        option_blocked=zeros((num, NUM_OPTIONS), bool),
        candidate_id=full((num, shown), NO_ID, np.int32),
        candidate_score=zeros((num, shown), scalar),
        candidate_final=zeros((num, shown), scalar),
        candidate_eligible=zeros((num, shown), bool),
        candidate_plausible=zeros((num, shown), bool),
        candidate_gate=zeros((num, shown), np.int32),
        candidate_bonus=zeros((num, shown), scalar),
        num_bad_patches=number(0),
    )


def grow(state: TrackerState, static: Static) -> TrackerState:
    """The same memory with the larger capacities of `static`, on the host."""
    empty = init(static)
    old_objects, new_objects = state.objects.id.shape[0], empty.objects.id.shape[0]

    def widen_rows(small: Array, large: Array) -> np.ndarray:
        """Rows of objects and rows of pending tracks move apart."""
        widened, rows = np.array(large), np.asarray(small)
        pending = rows[:, old_objects:]
        widened[:, :old_objects] = rows[:, :old_objects]
        widened[:, new_objects : new_objects + pending.shape[1]] = pending
        return widened

    banks = {
        name: jax.tree.map(widen_rows, getattr(state, name), getattr(empty, name))
        for name in ("appearance", "parts", "rings", "ring_prototypes")
    }
    # Banks have their size already: they are copied as they are.
    return extend(dataclasses.replace(state, **banks), empty)


def count_occupied(state: TrackerState) -> tuple[Int[Array, ""], Int[Array, ""]]:
    """Slots of objects and of pending tracks that are in use."""
    return jnp.sum(state.objects.exists), jnp.sum(state.pending.kind != Kind.FREE)
