"""Birth, confirmation, absence and removal of objects (paper III-F; method.md#lifecycle)."""

from __future__ import annotations

import dataclasses
import enum

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Int

from remind_jax.numerics.absent import NO_ID
from remind_jax.numerics.pytree import pytree
from remind_jax.numerics.ranks import count_before
from remind_jax.remind.memory.writing import find_writers, write_column
from remind_jax.remind.thresholds.memory import Lifecycle as Rules


class Lifecycle(enum.IntEnum):
    """Standing of an object (method.md#lifecycle)."""

    NEW = 0
    TENTATIVE = 1
    CONFIRMED = 2
    INACTIVE = 3


@pytree
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

    def id_of(self, slot: Int[Array, "*any"]) -> Int[Array, "*any"]:
        """Ids of the objects in these slots."""
        return jnp.where(slot >= 0, self.id[jnp.maximum(slot, 0)], NO_ID)


def create_objects(
    objects: Objects,
    class_id: Int[Array, "N"],
    is_new: Bool[Array, "N"],
    next_id: Int[Array, ""],
) -> tuple[Objects, Int[Array, "N"]]:
    """Gives each new detection the next free slot, `O` for the others, and id, in their order."""
    rank = count_before(is_new)
    return add_objects(objects, class_id, is_new, rank, next_id + rank)


def add_objects(
    objects: Objects,
    class_id: Int[Array, "N"],
    born: Bool[Array, "N"],
    rank: Int[Array, "N"],
    own_id: Int[Array, "N"],
) -> tuple[Objects, Int[Array, "N"]]:
    """Puts the objects that are born into the free slots by `rank`; the slot of others is `O`."""
    slots = objects.id.shape[0]
    slot = jnp.where(born, jnp.sum(objects.exists, dtype=jnp.int32) + rank, slots)
    nothing = jnp.zeros_like(own_id)
    begun = Objects(
        id=own_id,
        class_id=class_id,
        lifecycle=nothing + Lifecycle.NEW,
        hits=nothing,
        misses=nothing,
        age=nothing,
        last_seen=nothing,
    )
    writers = find_writers(slot, slots)
    return jax.tree.map(lambda old, new: write_column(old, writers, new), objects, begun), slot


def mark_seen(
    objects: Objects, sights: Int[Array, "O"], now: Int[Array, ""], rules: Rules
) -> Objects:
    """Counts the detections that show an object; two in all confirm it (method.md#lifecycle).

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
    """Counts a frame of absence, and says who may be forgotten for it (method.md#lifecycle)."""
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
    age = objects.age + missed
    return dataclasses.replace(objects, lifecycle=lifecycle, misses=misses, age=age), forgotten
