"""How detections write into the rows of memory: objects, undecided tracks, banks and graphs.

A scatter is compiled into a loop of its own for every array. Here it is found once which detection
writes a row, and short columns choose by it; where a row is large, one loop over the detections
writes all arrays in place.

Letters: `N` detections, `R` rows.
"""

from __future__ import annotations

import dataclasses
from typing import TypeVar

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Int, Shaped

from remind_jax.numerics.control_flow import repeat

T = TypeVar("T")


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Writers:
    """Who writes each row."""

    detection: Int[Array, "R"]  # 0 where nobody does
    written: Bool[Array, "R"]


def find_writers(row: Int[Array, "N"], num_rows: int) -> Writers:
    """Looks up who writes each row; of several detections the last one does.

    Args:
      row: Row that each detection writes, out of range for none.
      num_rows: Rows that there are.
    """
    turn = jnp.arange(1, row.shape[0] + 1, dtype=jnp.int32)[:, None]
    last = jnp.max(jnp.where(row[:, None] == jnp.arange(num_rows), turn, 0), axis=0, initial=0)
    return Writers(jnp.maximum(last - 1, 0), last > 0)


def write_column(
    column: Shaped[Array, "R ..."], writers: Writers, value: Shaped[Array, "N ..."] | int
) -> Shaped[Array, "R ..."]:
    """A column of memory with the values of those who write it."""
    value = jnp.asarray(value, column.dtype)
    if value.ndim:
        value = value.at[writers.detection].get(mode="promise_in_bounds")
    written = writers.written.reshape(-1, *(1,) * (column.ndim - 1))
    return jnp.where(written, value, column)


def write_rows(memory: T, row: Int[Array, "N"], values: T, axis: int = 0) -> T:
    """Memory with whole rows replaced, one detection after the other.

    Args:
      memory: Arrays with the rows along `axis`.
      row: Row that each detection writes, out of range for none.
      values: The new rows, with the detections along `axis`.
      axis: Where rows and detections are counted.
    """
    num_rows = jax.tree.leaves(memory)[0].shape[axis]
    written = (row >= 0) & (row < num_rows)
    at = jnp.clip(row, 0, num_rows - 1)
    turns = jnp.max(jnp.where(written, jnp.arange(1, row.shape[0] + 1), 0), initial=0)

    def write(carry: tuple[Array, T]) -> tuple[Array, T]:
        turn, memory = carry

        def put(leaf: Array, value: Array) -> Array:
            kept = jax.lax.dynamic_index_in_dim(leaf, at[turn], axis)
            new = jax.lax.dynamic_index_in_dim(value, turn, axis).astype(leaf.dtype)
            new = jnp.where(written[turn], new, kept)
            return jax.lax.dynamic_update_slice_in_dim(leaf, new, at[turn], axis)

        return turn + 1, jax.tree.map(put, memory, values)

    return repeat(lambda carry: carry[0] < turns, write, (jnp.int32(0), memory))[1]
