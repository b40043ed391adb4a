"""Connected components of small graphs."""

from __future__ import annotations

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool


def connect(linked: Bool[Array, "N N"]) -> Bool[Array, "N N"]:
    """Which entries a chain of links joins, by repeated squaring; an entry is linked to itself."""
    num = linked.shape[0]
    near = (linked | linked.T | jnp.eye(num, dtype=bool)).astype(jnp.float32)
    square = lambda _, reach: (reach @ reach > 0).astype(jnp.float32)  # noqa: E731
    return jax.lax.fori_loop(0, max(1, (num - 1).bit_length()), square, near) > 0
