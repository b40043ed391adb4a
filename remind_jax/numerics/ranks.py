"""Places in an order, found by comparing all pairs.

For the short axes of a frame one comparison of all pairs is a single kernel, where a sort or a
running sum is many.
"""

from __future__ import annotations

from collections.abc import Sequence

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Int, Shaped


def count_before(marked: Bool[Array, "... K"]) -> Int[Array, "... K"]:
    """Marked entries before each entry."""
    place = jnp.arange(marked.shape[-1])
    earlier = place < place[:, None]
    return jnp.sum(marked[..., None, :] & earlier, axis=-1, dtype=jnp.int32)


def rank_rising(keys: Sequence[Shaped[Array, "... K"]]) -> Int[Array, "... K"]:
    """Place of each entry by rising keys, of which the first decides first; then by position."""
    position = jnp.arange(keys[0].shape[-1])
    before, tie = False, True
    for key in (*keys, position):
        one, other = key[..., :, None], key[..., None, :]
        before, tie = before | (tie & (other < one)), tie & (other == one)
    return jnp.sum(before, axis=-1, dtype=jnp.int32)


def largest(
    values: Shaped[Array, "..."], axis: int = -1
) -> tuple[Shaped[Array, "..."], Int[Array, "..."]]:
    """Largest value along an axis and its place, the first among equals; NaN is none.

    One reduction finds both, where a maximum and its place would take one each.
    """
    axis %= values.ndim
    if values.dtype == bool:
        least = jnp.array(False)
    elif jnp.issubdtype(values.dtype, jnp.floating):
        least = jnp.array(-jnp.inf, values.dtype)
    else:
        least = jnp.array(jnp.iinfo(values.dtype).min, values.dtype)
    place = lax.broadcasted_iota(jnp.int32, values.shape, axis)

    def better(left: tuple[Array, Array], right: tuple[Array, Array]) -> tuple[Array, Array]:
        wins = (right[0] > left[0]) | ((right[0] == left[0]) & (right[1] < left[1]))
        return jnp.where(wins, right[0], left[0]), jnp.where(wins, right[1], left[1])

    nowhere = jnp.array(jnp.iinfo(jnp.int32).max, jnp.int32)
    return lax.reduce((values, place), (least, nowhere), better, (axis,))
