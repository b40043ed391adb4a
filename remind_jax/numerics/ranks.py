"""Places in an order, found by comparing all pairs.

For the short axes of a frame one comparison of all pairs is a single kernel, where a sort or a
running sum is many.
"""

from __future__ import annotations

from collections.abc import Sequence

import jax.numpy as jnp
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
