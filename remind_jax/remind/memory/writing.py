"""How detections write into the rows of memory: objects, undecided tracks, banks and graphs.

A scatter is compiled into a loop of its own for every array. Here it is found once which detection
writes a row, and short columns choose by it; where a row is large, one loop over the detections
writes all arrays in place.

Letters: `N` detections, `R` rows.
"""

from __future__ import annotations

import functools
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
from jax.custom_batching import custom_vmap
from jaxtyping import Array, Bool, Int, Shaped

from remind_jax.numerics.control_flow import count_up
from remind_jax.numerics.pytree import choose, pytree
from remind_jax.numerics.slices import give_axis

T = TypeVar("T")


@pytree
class Writers:
    """Who writes each row."""

    detection: Int[Array, "R"]  # 0 where nobody does
    written: Bool[Array, "R"]


def find_writers(row: Int[Array, "N"], num_rows: int) -> Writers:
    """Looks up who writes each row, the last of several; `row` is out of range for none."""
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
    return choose(writers.written, value, column)


def write_rows(memory: T, row: Int[Array, "N"], values: T, axis: int = 0) -> T:
    """Memory with whole rows replaced along an axis, one detection after the other.

    `row` is what each detection writes, out of range for none.
    """
    num_rows = jax.tree.leaves(memory)[0].shape[axis]
    written = (row >= 0) & (row < num_rows)
    at = jnp.clip(row, 0, num_rows - 1)
    turns = jnp.max(jnp.where(written, jnp.arange(1, row.shape[0] + 1), 0), initial=0)
    # In a batch, slices at the row of each member are a scatter, slow on a CPU.
    write = custom_vmap(functools.partial(_write_in_turn, axis))
    write.def_vmap(functools.partial(_write_batch, axis))
    return write(turns, written, at, memory, values)


def _write_in_turn(
    axis: int,
    turns: Int[Array, ""],
    written: Bool[Array, "N"],
    at: Int[Array, "N"],
    memory: T,
    values: T,
) -> T:
    """Rows of one memory, detection by detection."""

    def write(turn: Int[Array, ""], memory: T) -> T:
        def put(leaf: Array, value: Array) -> Array:
            kept = jax.lax.dynamic_index_in_dim(leaf, at[turn], axis)
            new = jax.lax.dynamic_index_in_dim(value, turn, axis).astype(leaf.dtype)
            new = jnp.where(written[turn], new, kept)
            return jax.lax.dynamic_update_slice_in_dim(leaf, new, at[turn], axis)

        return jax.tree.map(put, memory, values)

    return count_up(turns, write, memory, suits_all=True)


def _write_batch(
    axis: int,
    axis_size: int,
    in_batched: Any,
    turns: Int[Array, "..."],
    written: Bool[Array, "... N"],
    at: Int[Array, "... N"],
    memory: T,
    values: T,
) -> tuple[T, Any]:
    """The rows of all memories of a batch: on a CPU one after the other, in one loop."""
    given = turns, written, at, memory, values
    if jax.default_backend() != "cpu":
        axes = jax.tree.map(lambda batched: 0 if batched else None, tuple(in_batched))
        memory = jax.vmap(functools.partial(_write_in_turn, axis), axes)(*given)
        return memory, jax.tree.map(lambda _: True, memory)

    turns, written, at, memory, values = jax.tree.map(
        lambda leaf, own: give_axis(leaf, own, axis_size), given, tuple(in_batched)
    )

    def write(number: Int[Array, ""], memory: T) -> T:
        turn, member = number // axis_size, number % axis_size
        row, is_written = at[member, turn], written[member, turn]

        def put(leaf: Array, value: Array) -> Array:
            def place(index: Array) -> list[Array | int]:
                return [member, *[0] * axis, index, *[0] * (leaf.ndim - axis - 2)]

            size = (1, *leaf.shape[1 : axis + 1], 1, *leaf.shape[axis + 2 :])
            kept = jax.lax.dynamic_slice(leaf, place(row), size)
            new = jax.lax.dynamic_slice(value, place(turn), size).astype(leaf.dtype)
            return jax.lax.dynamic_update_slice(leaf, jnp.where(is_written, new, kept), place(row))

        return jax.tree.map(put, memory, values)

    memory = jax.lax.fori_loop(0, axis_size * jnp.max(turns), write, memory)
    return memory, jax.tree.map(lambda _: True, memory)
