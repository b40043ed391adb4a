"""Decisions that all entries of a batch share, so that loops and branches stay real under vmap."""

from __future__ import annotations

import jax
import jax.numpy as jnp
from jaxtyping import Array, Shaped


@jax.custom_batching.custom_vmap
def batch_max(value: Shaped[Array, ""]) -> Shaped[Array, ""]:
    """Largest value (or any flag) over whatever batch the caller is mapped to; itself if none.

    A `cond` or `while_loop` on the result decides once for the whole batch, where a value of each
    entry would make vmap run all branches, or select the whole carry in every round. Only for
    decisions that do not change results: capacities, and loops whose body leaves what is done.
    """
    return value


@batch_max.def_vmap
def _batch_max_mapped(axis_size, in_batched, value):
    del axis_size
    (batched,) = in_batched
    return (batch_max(jnp.max(value, axis=0)) if batched else batch_max(value)), False
