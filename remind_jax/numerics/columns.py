"""Values side by side along a last axis."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Shaped


def columns(*values: Shaped[Array, "..."] | int) -> Shaped[Array, "... K"]:
    """Values side by side along a last axis.

    A choice by place becomes part of whatever reads it, where a concatenation is a kernel.
    """
    *others, chosen = jnp.broadcast_arrays(*values)
    chosen = chosen[..., None]
    place = np.arange(len(values))
    for index, value in enumerate(others):
        chosen = jnp.where(place == index, value[..., None], chosen)
    return chosen
