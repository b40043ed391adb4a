"""Which row of a frame has which object slot.

A slot belongs to one row at most. So what rows teach their objects is read by the objects: each
looks up its row, which is one operation for all of them, where writing is one per row.

Letters: `M` rows (detections or tracklets), `O` object slots.
"""

from __future__ import annotations

import jax.numpy as jnp
from jaxtyping import Array, Bool, Int, Shaped

NO_ROW = -1


def rows_of(slot: Int[Array, "*S M"], has: Bool[Array, "M"], num: int) -> Int[Array, "*S O"]:
    """The row that has each of `num` slots, NO_ROW where none has."""
    row = jnp.arange(len(has), dtype=jnp.int32)[:, None]
    is_at = (slot[..., None] == jnp.arange(num)) & has[:, None]
    return jnp.max(jnp.where(is_at, row, NO_ROW), axis=-2)


def count_before(flags: Bool[Array, "M"]) -> Int[Array, "M"]:
    """How many flags are set in the rows before each."""
    index = jnp.arange(len(flags))
    return jnp.sum((index[None] < index[:, None]) & flags[None], axis=1, dtype=jnp.int32)


def look_up(
    table: Shaped[Array, "O O *more"], first: Int[Array, "*#any"], second: Int[Array, "*#any"]
) -> Shaped[Array, "*all"]:
    """Entries of a table of pairs by the slots of both, which broadcast; all must be slots."""
    num = len(table)
    flat = table.reshape(num * num, *table.shape[2:])
    return flat.at[first * num + second].get(mode="promise_in_bounds", wrap_negative_indices=False)
