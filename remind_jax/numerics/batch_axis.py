"""Arrays under `vmap`: which of them have an axis for the batch, and how the others get one."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import jax.numpy as jnp
from jax.custom_batching import custom_vmap
from jaxtyping import Array, Float


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
