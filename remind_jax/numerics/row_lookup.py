"""Entries of each row of a table by their place in the row."""

from __future__ import annotations

import jax.numpy as jnp
from jaxtyping import Array, Int, Shaped


def look_up_in_rows(
    table: Shaped[Array, "N M *more"], index: Int[Array, "N K"]
) -> Shaped[Array, "N K *more"]:
    """Entries of each row; `index` must be in the row.

    The table is read as one long row: an index of two parts would be an array of its own.
    """
    rows, columns = table.shape[:2]
    flat = table.reshape(rows * columns, *table.shape[2:])
    at = index + columns * jnp.arange(rows, dtype=index.dtype)[:, None]
    return flat.at[at].get(mode="clip", wrap_negative_indices=False)
