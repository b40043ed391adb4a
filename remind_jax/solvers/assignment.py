"""Joint assignment of detections to objects, class by class (method.md#joint-assignment).

Letters: `N` rows (detections), `M` columns (objects by rising id).
"""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from remind_jax.errors import ConfigError
from remind_jax.numerics.absent import NO_SLOT
from remind_jax.solvers.assignment_in_graph import FORBIDDEN_COST, assign_in_graph


def assign(
    scores: Float[Array, "N M"],
    allowed: Bool[Array, "N M"],
    group: Int[Array, "N"],
    dummy: Float[Array, "N"],
    dummies: Bool[Array, ""],
    present: Bool[Array, "N M"] | None = None,
    *,
    solver: str,
) -> Int[Array, "N"]:
    """Column of every row, -1 if it gets none, so that the summed score is largest.

    Rows of different groups never share a column. With `dummies`, a row may stay without a column
    for the score `dummy[row]`; without them, as many rows as possible get one. Ties fall as in
    `scipy.optimize.linear_sum_assignment` on each group's own matrix (method.md#assignment-ties).

    Args:
      allowed: Pairs that may be assigned; a row without any takes no part.
      group: Class of each row.
      present: Pairs that stand in the matrix of the row's group, allowed or not; `allowed` if left
        out. A column that no row may have can still decide a tie.
      solver: `"host"`: SciPy in one callback for all groups and batch entries; `"jax"`: the same
        procedure in the graph, with equal results.
    """
    scores, dummy = jax.lax.stop_gradient((scores, dummy))  # columns are whole numbers
    if solver == "jax":
        return assign_in_graph(scores, allowed, group, dummy, dummies, present)
    if solver != "host":
        raise ConfigError(f"solver {solver!r} is unknown; use 'host' or 'jax'")
    out = jax.ShapeDtypeStruct(group.shape, jnp.int32)
    given = (scores, allowed, group, dummy, dummies, allowed if present is None else present)
    return jax.pure_callback(_assign_batched, out, *given, vmap_method="broadcast_all")


def _assign_batched(*given: Array) -> np.ndarray:
    """`assign_groups` over any leading batch axes."""
    leaves: list[Any] = [np.asarray(leaf) for leaf in given]
    group = leaves[2]
    columns = np.empty(group.shape, np.int32)
    for index in np.ndindex(group.shape[:-1]):
        columns[index] = assign_groups(*(leaf[index] for leaf in leaves))
    return columns


def assign_groups(
    scores: Float[np.ndarray, "N M"],
    allowed: Bool[np.ndarray, "N M"],
    group: Int[np.ndarray, "N"],
    dummy: Float[np.ndarray, "N"],
    dummies: bool,
    present: Bool[np.ndarray, "N M"] | None = None,
) -> Int[np.ndarray, "N"]:
    """NumPy and SciPy form of `assign` for one frame."""
    from scipy import optimize  # takes longer to import than all else here

    column = np.full(len(group), NO_SLOT, np.int32)
    active = allowed.any(axis=1)
    # A row without any allowed pair still takes a dummy in the original; as each row has its own
    # dummy at the same price for all, leaving it out changes nothing with dummies. Without them it
    # would only take a forbidden cell, which is rejected afterwards.
    for label in np.unique(group[active]):
        rows = (
            np.flatnonzero(group == label)
            if not dummies
            else np.flatnonzero((group == label) & active)
        )
        columns = np.flatnonzero((allowed if present is None else present)[rows].any(axis=0))
        cost = np.where(
            allowed[np.ix_(rows, columns)],
            -scores[np.ix_(rows, columns)].astype(np.float64),
            FORBIDDEN_COST,
        )
        if dummies:
            price = np.repeat(-dummy[rows, None].astype(np.float64), len(rows), axis=1)
            cost = np.concatenate([cost, price], axis=1)
        chosen_rows, chosen = optimize.linear_sum_assignment(cost)
        real = chosen < len(columns)
        picked_rows, picked = rows[chosen_rows[real]], columns[chosen[real]]
        fits = allowed[picked_rows, picked]
        column[picked_rows[fits]] = picked[fits]
    return column
