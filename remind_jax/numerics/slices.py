"""Slices at a place that a whole batch shares, which stay slices under `vmap`.

JAX makes a gather or a scatter of them, whose indices are arrays that are checked at every turn of
a loop.
"""

from __future__ import annotations

import functools
from collections.abc import Callable

import jax
from jax.custom_batching import custom_vmap
from jaxtyping import Array, Int, Shaped

from remind_jax.numerics.batch_axis import give_axis


def take_slice(
    array: Shaped[Array, "..."], start: Int[Array, ""] | int, length: int, axis: int = 0
) -> Shaped[Array, "..."]:
    """So many rows along an axis, counted from the first one, from `start` on."""

    def take(axis: int, array: Array, start: Array) -> Array:
        return jax.lax.dynamic_slice_in_dim(array, start, length, axis)

    return _share_place(take, axis, array, start)


def put_slice(
    array: Shaped[Array, "..."],
    rows: Shaped[Array, "..."],
    start: Int[Array, ""] | int,
    axis: int = 0,
) -> Shaped[Array, "..."]:
    """The array with some rows along an axis replaced, from `start` on."""

    def put(axis: int, array: Array, rows: Array, start: Array) -> Array:
        return jax.lax.dynamic_update_slice_in_dim(array, rows, start, axis)

    return _share_place(put, axis, array, rows, start)


def _share_place(function: Callable[..., Array], axis: int, *given: Array | int) -> Array:
    """`function(axis, *arrays, start)`, which in a batch with one start goes one axis further."""
    apply = custom_vmap(functools.partial(function, axis))

    @apply.def_vmap
    def apply_to_batch(size: int, is_batched: list[bool], *given: Array) -> tuple[Array, bool]:
        *arrays, start = given
        if is_batched[-1]:
            axes = [0 if batched else None for batched in is_batched]
            return jax.vmap(functools.partial(function, axis), axes)(*given), True
        arrays = [
            give_axis(array, batched, size)
            for array, batched in zip(arrays, is_batched, strict=False)
        ]
        return _share_place(function, axis + 1, *arrays, start), True

    return apply(*given)
