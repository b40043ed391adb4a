"""Places in an order, found by comparing all pairs.

For the short axes of a frame one comparison of all pairs is a single kernel, where a sort or a
running sum is many.
"""

from __future__ import annotations

from collections.abc import Sequence

import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Bool, Float, Int, Shaped

from remind_jax.numerics.absent import NO_SLOT
from remind_jax.numerics.reductions import reduce_together


def count_before(marked: Bool[Array, "... K"]) -> Int[Array, "... K"]:
    """Marked entries before each entry."""
    place = np.arange(marked.shape[-1])
    earlier = np.expand_dims(place < place[:, None], tuple(range(marked.ndim - 1)))
    return jnp.sum(marked[..., None, :] & earlier, axis=-1, dtype=jnp.int32)


def rank_rising(keys: Sequence[Shaped[Array, "... K"]]) -> Int[Array, "... K"]:
    """Place of each entry by rising keys, of which the first decides first; then by position."""
    position = jnp.arange(keys[0].shape[-1])
    before, tie = False, True
    for key in (*keys, position):
        one, other = key[..., :, None], key[..., None, :]
        before, tie = before | (tie & (other < one)), tie & (other == one)
    return jnp.sum(before, axis=-1, dtype=jnp.int32)


def order_rising(keys: Sequence[Shaped[Array, "... K"]]) -> Int[Array, "... K"]:
    """Positions of the entries by rising keys, as `rank_rising` ranks them."""
    rank, position = rank_rising(keys), np.arange(keys[0].shape[-1], dtype=np.int32)
    is_at = rank[..., None, :] == position[:, None]
    return jnp.sum(jnp.where(is_at, position, 0), axis=-1)


def largest(
    values: Shaped[Array, "..."], axis: int = -1
) -> tuple[Shaped[Array, "..."], Int[Array, "..."]]:
    """Largest value along an axis and its place, the first among equals; NaN is none.

    Two quick reductions: on a CPU one of pairs, such as `jnp.argmax`, takes ten times as long.
    """
    if jnp.issubdtype(values.dtype, jnp.floating):
        values = jnp.where(jnp.isnan(values), -jnp.inf, values)
    top, size = jnp.max(values, axis=axis, keepdims=True), values.shape[axis]
    place = lax.broadcasted_iota(jnp.int32, values.shape, axis % values.ndim)
    first = jnp.min(jnp.where(values == top, place, size), axis=axis)
    return jnp.squeeze(top, axis), first


def rank_two(
    values: Float[Array, "*B K"], among: Bool[Array, "*B K"]
) -> tuple[Int[Array, "*B"], Float[Array, "*B"], Float[Array, "*B"], Int[Array, "*B"]]:
    """Place of the largest value that counts, that value, the second largest, and how many count.

    The first among equals; a value that there is not is 0.
    """
    masked = jnp.where(among, values, -jnp.inf)
    top, best = largest(masked)
    rest = jnp.where(jnp.arange(values.shape[-1]) == best[..., None], -jnp.inf, masked)
    second, number = reduce_together(("max", rest), ("sum", among), axis=-1)
    finite = lambda x: jnp.where(jnp.isfinite(x), x, 0.0)  # noqa: E731
    return best, finite(top), finite(second), number


def pick_best(
    values: Float[Array, "*B K"], among: Bool[Array, "*B K"], most: int, later_first: bool = False
) -> tuple[Int[Array, "*B M"], Float[Array, "*B M"]]:
    """Places and values of the largest finite entries that count, NO_SLOT and 0 behind them.

    Of equals the first one, with `later_first` the last one is first.
    """
    num = values.shape[-1]
    masked, shown = jnp.where(among, values, -jnp.inf), min(most, num)
    top, place = lax.top_k(masked[..., ::-1] if later_first else masked, shown)
    real = jnp.isfinite(top)
    place = jnp.where(real, num - 1 - place if later_first else place, NO_SLOT).astype(jnp.int32)
    lacking = (*((0, 0),) * (values.ndim - 1), (0, most - shown))
    top = jnp.pad(jnp.where(real, top, 0.0), lacking)
    return jnp.pad(place, lacking, constant_values=NO_SLOT), top


def first_largest(
    keys: Sequence[Float[Array, "I J"]], among: Bool[Array, "I J"] | None = None
) -> tuple[Array, ...]:
    """The largest entry of a table by several keys, of which the first decides first.

    Args:
      keys: At least one; NaN is never the largest.
      among: Entries that count, all if not given. The keys of the others must be -inf.

    Returns:
      Its keys, its row and its column: the first one by rows among equals. Both are past the table
      where no entry counts.
    """
    rows, columns = np.indices(keys[0].shape, np.int32)
    nowhere = jnp.array(jnp.iinfo(jnp.int32).max, jnp.int32)
    places = [
        jnp.asarray(place) if among is None else jnp.where(among, place, nowhere)
        for place in (rows, columns)
    ]

    def better(left: tuple[Array, ...], right: tuple[Array, ...]) -> tuple[Array, ...]:
        wins, tie = False, True
        for one, other in zip(left[:-2], right[:-2], strict=True):
            wins, tie = wins | (tie & (other > one)), tie & (other == one)
        for one, other in zip(left[-2:], right[-2:], strict=True):
            wins, tie = wins | (tie & (other < one)), tie & (other == one)
        return tuple(jnp.where(wins, *pair) for pair in zip(right, left, strict=True))

    starts = [jnp.array(-jnp.inf, key.dtype) for key in keys]
    return tuple(lax.reduce((*keys, *places), (*starts, nowhere, nowhere), better, (0, 1)))
