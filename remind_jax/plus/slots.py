"""Which row of a frame has which object slot, and how objects get slots and free them.

A slot belongs to one row at most. So what rows teach their objects is read by the objects: each
looks up its row, which is one operation for all of them, where writing is one per row.

Letters: `M` rows (detections `N` or tracklets `T`), `O` object slots.
"""

from __future__ import annotations

import dataclasses

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, Shaped

from remind_jax.numerics.pytree import choose
from remind_jax.numerics.ranks import count_before
from remind_jax.plus.state import Objects, Pairs, Tracklets

NO_ROW = -1


def rows_of(slot: Int[Array, "*S M"], has: Bool[Array, "M"], num: int) -> Int[Array, "*S O"]:
    """The row that has each of `num` slots, NO_ROW where none has."""
    row = jnp.arange(len(has), dtype=jnp.int32)[:, None]
    is_at = (slot[..., None] == jnp.arange(num)) & has[:, None]
    return jnp.max(jnp.where(is_at, row, NO_ROW), axis=-2)


def look_up(
    table: Shaped[Array, "O O *more"], first: Int[Array, "*#any"], second: Int[Array, "*#any"]
) -> Shaped[Array, "*all"]:
    """Entries of a table of pairs by the slots of both, which broadcast; all must be slots."""
    num = len(table)
    flat = table.reshape(num * num, *table.shape[2:])
    return flat.at[first * num + second].get(mode="promise_in_bounds", wrap_negative_indices=False)


def create_objects(
    objects: Objects,
    pairs: Pairs,
    tracklets: Tracklets,
    born: Bool[Array, "T"],
    place_variance: Float[Array, "T"],
    speed: Float[Array, "T"],
) -> tuple[Objects, Pairs, Int[Array, "T"]]:
    """Gives new objects the lowest free slots, in the order of the tracklets.

    Returns:
      Objects, pairs, and the slot of each tracklet (its own before where nothing was created).
    """
    num_o = len(objects.id)
    free = jnp.argsort(objects.exists, stable=True)
    lowest = free[jnp.minimum(count_before(born), num_o - 1)].astype(jnp.int32)
    slot = jnp.where(born, lowest, tracklets.slot)
    row = rows_of(slot, born, num_o)
    is_new = row != NO_ROW
    of_tracklet = ("id", "class_id", "class_lead", "last", "size")
    new = dataclasses.replace(
        objects,
        **{name: getattr(tracklets, name)[row] for name in of_tracklet},
        position=tracklets.center[row],
        speed=speed[row],
        visits=1,
        **dict.fromkeys(("seen", "bank_count", "ring", "ring_count"), 0),
    )
    objects = choose(is_new, new, objects)
    # Nothing is known between a free slot and the others, so there is nothing to clear.
    own = jnp.eye(num_o, dtype=bool) & is_new
    covariance = jnp.where(own, place_variance[row], pairs.covariance)
    return objects, dataclasses.replace(pairs, covariance=covariance), slot
