"""Assignment without looking ahead: the best pair first (ablation of paper III-D)."""

from __future__ import annotations

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from remind_jax.numerics.absent import NO_SLOT


def assign_greedily(
    scores: Float[Array, "N M"],
    allowed: Bool[Array, "N M"],
    dummy: Float[Array, "N"],
    dummies: Bool[Array, ""],
) -> Int[Array, "N"]:
    """Gives away the pairs by falling score, each row and column once; -1 where a row gets none.

    Among equals the lower row goes first, then the lower column. Below the score `dummy` a row
    rather stays without a column.
    """
    num_rows, num_columns = scores.shape
    worth = allowed & (~dummies | (scores >= dummy[:, None]))

    def give(_: Array, carry: tuple[Array, Array]) -> tuple[Array, Array]:
        column, left = carry
        best = jnp.argmax(left)
        row, to = best // num_columns, best % num_columns
        some = left[row, to] > -jnp.inf
        column = jnp.where(some & (jnp.arange(num_rows) == row), to, column)
        gone = (jnp.arange(num_rows) == row)[:, None] | (jnp.arange(num_columns) == to)[None, :]
        return column.astype(jnp.int32), jnp.where(gone, -jnp.inf, left)

    nobody = jnp.full(num_rows, NO_SLOT, jnp.int32)
    start = (nobody, jnp.where(worth, scores, -jnp.inf))
    return jax.lax.fori_loop(0, min(num_rows, num_columns), give, start)[0]
