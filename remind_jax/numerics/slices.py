"""Slices at a place that a whole batch shares, which stay slices under `vmap`.

JAX makes a gather or a scatter of them, whose indices are arrays that are checked at every turn of
a loop.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
from jax.custom_batching import custom_vmap
from jaxtyping import Array, Float, Int, Shaped


def give_axis(leaf: Any, is_batched: bool, size: int) -> Array:
    """The array with the axis of a batch in front: as it is, or the same for all members."""
    return leaf if is_batched else jnp.broadcast_to(leaf, (size, *leaf.shape))


@custom_vmap
def spread_over_batch(
    left: Float[Array, "..."], right: Float[Array, "..."]
) -> tuple[Float[Array, "..."], Float[Array, "..."]]:
    """Both factors of a product, each with an axis for whatever batch one of them is mapped to.

    A factor that a batch shares makes one long product of all members, for which the other factor
    is turned around: with prototypes, that takes longer than the product.
    """
    return left, right


@spread_over_batch.def_vmap
def _spread_in_batch(
    size: int, is_batched: Sequence[bool], left: Array, right: Array
) -> tuple[tuple[Array, Array], tuple[bool, bool]]:
    both = give_axis(left, is_batched[0], size), give_axis(right, is_batched[1], size)
    return spread_over_batch(*both), (True, True)


def take_slice(
    array: Shaped[Array, "..."], start: Int[Array, ""] | int, length: int, axis: int = 0
) -> Shaped[Array, "..."]:
    """So many rows along an axis, counted from the first one, from `start` on."""

    def take(axis: int, array: Array, start: Array) -> Array:
        return jax.lax.dynamic_slice_in_dim(array, start, length, axis)

    return _share_place(take, axis, array, start)


def put_slice(
    array: Shaped[Array, "..."], rows: Shaped[Array, "..."], start: Int[Array, ""] | int
) -> Shaped[Array, "..."]:
    """The array with some rows replaced, from `start` on."""

    def put(axis: int, array: Array, rows: Array, start: Array) -> Array:
        return jax.lax.dynamic_update_slice_in_dim(array, rows, start, axis)

    return _share_place(put, 0, array, rows, start)


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
