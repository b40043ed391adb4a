"""What all baselines share: objects by slot, and the turn from a matching to decisions and memory.

Letters: `N` detection slots, `O` object slots, `D` feature dimension.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from remind_jax.decision import Decisions, Outcome, Overflow, Reason, no_decisions
from remind_jax.numerics.absent import NEVER, NO_ID
from remind_jax.numerics.array_faults import outside
from remind_jax.numerics.constant_arrays import full, number
from remind_jax.numerics.pytree import pytree
from remind_jax.observation import Masks
from remind_jax.static import Static


@pytree
class Objects:
    """One row per remembered object."""

    id: Int[Array, "O"]  # -1 in free slots
    class_id: Int[Array, "O"]
    last_seen: Int[Array, "O"]  # frame

    @property
    def exists(self) -> Bool[Array, "O"]:
        """Slots in use."""
        return self.id != NO_ID


@pytree
class SceneMemory:
    """Everything that one frame hands to the next, and the decisions of the last frame."""

    objects: Objects
    looks: Any  # what the method remembers of objects: a pytree of arrays `[O, ...]`
    next_id: Int[Array, ""]
    frame: Int[Array, ""]  # frames processed so far
    decisions: Decisions
    overflow: Overflow


@dataclasses.dataclass(frozen=True)
class Matching:
    """Who is who in one frame."""

    score: Float[Array, "N O"]  # of each pair
    allowed: Bool[Array, "N O"]  # pairs that could have been matched
    column: Int[Array, "N"]  # object slot of each detection, -1 without
    starts: Bool[Array, "N"]  # detections that become new objects
    usable: Bool[Array, "N"]  # detections that could be compared at all


# From what was remembered, the object slot of each detection (`O`: none) and whether it is new.
Learn = Callable[[Any, Int[Array, "N"], Bool[Array, "N"]], Any]


def empty_memory(static: Static, looks: Any) -> SceneMemory:
    """A memory without objects."""

    def column(value: int) -> Array:
        return full(static.num_objects, int(value), np.int32)

    empty = SceneMemory(
        objects=Objects(id=column(NO_ID), class_id=column(NO_ID), last_seen=column(NEVER)),
        looks=looks,
        next_id=number(static.first_object_id),
        frame=number(0),
        decisions=no_decisions(static),
        overflow=Overflow(objects=number(0), pending=number(0)),
    )
    return jax.device_put(empty)


def find_faults(memory: SceneMemory) -> Iterator[str]:
    """Phrases about values that no run makes; leaves are host arrays of the right shapes."""
    objects, now = memory.objects, int(memory.frame) - 1
    used = np.asarray(objects.id) != NO_ID
    yield from outside("objects.last_seen", objects.last_seen, NEVER, max(now, NEVER), used)


def remove_objects(
    memory: SceneMemory, empty: SceneMemory, ids: Int[np.ndarray, "ids"]
) -> SceneMemory:
    """The memory without some objects: their rows are those of `empty` (host)."""
    gone = np.isin(np.asarray(memory.objects.id), ids)

    def clear(leaf: Array, none: Array) -> np.ndarray:
        rows = gone.reshape(-1, *[1] * (leaf.ndim - 1))
        return np.where(rows, np.asarray(none), np.asarray(leaf))

    return dataclasses.replace(
        memory,
        objects=jax.tree.map(clear, memory.objects, empty.objects),
        looks=jax.tree.map(clear, memory.looks, empty.looks),
    )


def same_class(memory: SceneMemory, masks: Masks) -> Bool[Array, "N O"]:
    """Detections and objects of one class."""
    objects = memory.objects
    return (masks.class_id[:, None] == objects.class_id) & objects.exists & masks.valid[:, None]


def conclude(
    memory: SceneMemory,
    masks: Masks,
    matching: Matching,
    learn: Learn,
    static: Static,
    num_bad_patches: Int[Array, ""] | int = 0,
) -> SceneMemory:
    """The memory after a frame: matched objects are seen, new ones take the first free slots.

    If there are too few free slots, only `overflow` changes.
    """
    objects, num_slots = memory.objects, static.num_objects
    starts = matching.starts & (matching.column < 0)
    rank = jnp.cumsum(starts) - 1
    free = jnp.nonzero(~objects.exists, size=static.num_detections, fill_value=num_slots)[0]
    num_new, num_free = jnp.sum(starts), jnp.sum(~objects.exists)
    slot = jnp.where(matching.column >= 0, matching.column, num_slots)
    slot = jnp.where(starts, free[jnp.maximum(rank, 0)], slot)
    own_id = jnp.where(matching.column >= 0, objects.id[matching.column], NO_ID)
    own_id = jnp.where(starts, memory.next_id + rank, own_id).astype(jnp.int32)

    def write(values: Array, new: Array) -> Array:
        return values.at[slot].set(new, mode="drop")

    after = SceneMemory(
        objects=Objects(
            id=write(objects.id, own_id),
            class_id=write(objects.class_id, masks.class_id),
            last_seen=write(objects.last_seen, jnp.full_like(own_id, memory.frame)),
        ),
        looks=learn(memory.looks, slot, starts),
        next_id=memory.next_id + num_new.astype(jnp.int32),
        frame=memory.frame + 1,
        decisions=_decide(memory, masks, matching, starts, own_id, static, num_bad_patches),
        overflow=memory.overflow,
    )
    fits = num_new <= num_free
    kept = jax.tree.map(lambda new, old: jnp.where(fits, new, old), after, memory)
    lacking = jnp.where(fits, 0, num_slots - num_free + num_new).astype(jnp.int32)
    return dataclasses.replace(kept, overflow=Overflow(lacking, jnp.int32(0)))


def _decide(
    memory: SceneMemory,
    masks: Masks,
    matching: Matching,
    starts: Bool[Array, "N"],
    own_id: Int[Array, "N"],
    static: Static,
    num_bad_patches: Int[Array, ""] | int,
) -> Decisions:
    """What became of each detection."""
    is_match = matching.column >= 0
    conditions = [~masks.valid, is_match, starts, ~matching.usable]

    def choose(codes: list[int]) -> Int[Array, "N"]:
        return jnp.select(conditions, [jnp.int32(code) for code in codes[:-1]], codes[-1])

    shown_id, shown_score = _rank(memory, matching, static)
    match_score = jnp.take_along_axis(matching.score, matching.column[:, None], axis=1)[:, 0]
    score = jnp.where(is_match, match_score, 0.0).astype(static.scalar)
    eligible = shown_id != NO_ID
    blank = no_decisions(static)
    return dataclasses.replace(
        blank,
        outcome=choose(
            [Outcome.EMPTY, Outcome.MATCH, Outcome.NEW, Outcome.DROPPED, Outcome.UNASSIGNED]
        ),
        reason=choose(
            [
                Reason.NONE,
                Reason.ASSIGNED,
                Reason.CREATED_NEW,
                Reason.INVALID_INPUT,
                Reason.NO_ASSIGNMENT,
            ]
        ),
        object_id=own_id,
        score=score,
        confidence=jnp.clip(score, 0.0, 1.0),
        best_score=shown_score[:, 0],
        second_score=shown_score[:, 1] if shown_score.shape[1] > 1 else blank.second_score,
        candidate_id=shown_id,
        candidate_score=shown_score,
        candidate_final=shown_score,
        candidate_eligible=eligible,
        candidate_plausible=eligible,
        num_bad_patches=jnp.asarray(num_bad_patches, jnp.int32),
    )


def _rank(
    memory: SceneMemory, matching: Matching, static: Static
) -> tuple[Int[Array, "N C"], Float[Array, "N C"]]:
    """The best candidates of each detection by falling score; padding is -1 and 0."""
    num = min(static.num_candidates, static.num_objects)
    score, slot = jax.lax.top_k(jnp.where(matching.allowed, matching.score, -jnp.inf), num)
    shown = jnp.isfinite(score)
    lacking = ((0, 0), (0, static.num_candidates - num))
    ids = jnp.where(shown, memory.objects.id[slot], NO_ID)
    score = jnp.where(shown, score, 0.0).astype(static.scalar)
    return jnp.pad(ids, lacking, constant_values=NO_ID), jnp.pad(score, lacking)
