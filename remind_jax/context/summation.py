"""Sums whose rounding does not depend on the compiler.

Sets that are equally good by the rules differ in the last bit, by the order in which their terms
were added, and that bit decides which of them comes first. Adding in the original's order keeps
such decisions.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

_UNROLL = 16  # additions per turn of the loop


def sum_in_order(values: Float[Array, "X *B"]) -> Float[Array, "*B"]:
    """Adds along the first axis, one after the other."""
    start = jnp.zeros_like(values[0])
    total, _ = jax.lax.scan(lambda so_far, x: (so_far + x, None), start, values, unroll=_UNROLL)
    return total
