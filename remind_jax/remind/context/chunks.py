"""Work on the rows that are in use, however many there may be."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Int

from remind_jax.numerics.control_flow import count_up
from remind_jax.numerics.slices import put_slice, take_slice

_LENGTH = 16  # rows worked on at once


def by_chunks(function: Callable[[Any], Any], rows: Any, used: Int[Array, ""]) -> Any:
    """Applies a function of rows to the first ones, a few at a time.

    The others give zeros, or what the function makes of them.

    Args:
      function: Takes and gives pytrees with rows along the first axes; treats each row alone.
    """
    width = jax.tree.leaves(rows)[0].shape[0]
    length = min(_LENGTH, width)

    def part(start: Int[Array, ""] | int) -> Any:
        return jax.tree.map(lambda leaf: take_slice(leaf, start, length), rows)

    shapes = jax.eval_shape(lambda: function(part(0)))
    results = jax.tree.map(lambda leaf: jnp.zeros((width, *leaf.shape[1:]), leaf.dtype), shapes)

    def step(chunk: Array, results: Any) -> Any:
        # The last chunk may reach back to rows that are done; they come out the same.
        start = jnp.minimum(chunk * length, width - length)
        return jax.tree.map(
            lambda whole, new: put_slice(whole, new, start),
            results,
            function(part(start)),
        )

    chunks = jax.lax.div(used + length - 1, jnp.int32(length))
    return count_up(chunks, step, results, suits_all=True)
