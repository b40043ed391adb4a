"""Several reductions along one axis in one pass, and components of small graphs.

The compiler makes a kernel of every reduction, also where several read the same rows.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any, Literal

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Bool, Int, Shaped


def connect(linked: Bool[Array, "N N"]) -> Bool[Array, "N N"]:
    """Which entries a chain of links joins, by repeated squaring; an entry is linked to itself."""
    num = linked.shape[0]
    near = (linked | linked.T | jnp.eye(num, dtype=bool)).astype(jnp.float32)
    square = lambda _, reach: (reach @ reach > 0).astype(jnp.float32)  # noqa: E731
    return jax.lax.fori_loop(0, max(1, (num - 1).bit_length()), square, near) > 0


Kind = Literal["sum", "max", "min", "any", "all", "top"]

_COMBINE: dict[str, Callable[[Array, Array], Array]] = {
    "sum": jnp.add,
    "max": jnp.maximum,
    "min": jnp.minimum,
    "any": jnp.logical_or,
    "all": jnp.logical_and,
}


def reduce_together(*terms: tuple[Kind, Shaped[Array, "..."]], axis: int) -> tuple[Any, ...]:
    """Each term reduced along an axis in its own way; the terms are broadcast.

    A sum of truth values counts them. Sums are added in the order of the axis. `"top"` gives the
    largest value and its place, the first among equals; NaN is none.
    """
    kinds: list[Kind] = [kind for kind, _ in terms]
    values = jnp.broadcast_arrays(
        *(_counted(value) if kind == "sum" else value for kind, value in terms)
    )
    axis %= values[0].ndim
    place = lax.broadcasted_iota(jnp.int32, values[0].shape, axis)
    nowhere = jnp.array(jnp.iinfo(jnp.int32).max, jnp.int32)
    given, starts = [], []
    for kind, value in zip(kinds, values, strict=True):
        given += [value, place] if kind == "top" else [value]
        start = _start(kind, value.dtype)
        starts += [start, nowhere] if kind == "top" else [start]

    def combine(left: tuple[Array, ...], right: tuple[Array, ...]) -> tuple[Array, ...]:
        one, other, combined = iter(left), iter(right), []
        for kind in kinds:
            if kind == "top":
                combined += _better(next(one), next(one), next(other), next(other))
            else:
                combined.append(_COMBINE[kind](next(one), next(other)))
        return tuple(combined)

    found = iter(lax.reduce(tuple(given), tuple(starts), combine, (axis,)))
    return tuple((next(found), next(found)) if kind == "top" else next(found) for kind in kinds)


def pick_in_rows(
    index: Int[Array, "N"], *tables: Shaped[Array, "N M"]
) -> tuple[Shaped[Array, "N"], ...]:
    """The entry of each row of some tables at a place, 0 where it is not in the row."""
    is_there = index[:, None] == jnp.arange(tables[0].shape[1])
    terms: list[tuple[Kind, Array]] = [
        ("any", is_there & table) if table.dtype == bool else ("sum", jnp.where(is_there, table, 0))
        for table in tables
    ]
    return reduce_together(*terms, axis=1)


def _better(value: Array, place: Array, other: Array, other_place: Array) -> list[Array]:
    wins = (other > value) | ((other == value) & (other_place < place))
    return [jnp.where(wins, other, value), jnp.where(wins, other_place, place)]


def _counted(value: Array) -> Array:
    return value.astype(jnp.int32) if value.dtype == bool else value


def _start(kind: Kind, dtype: Any) -> Array:
    """What changes nothing."""
    if np.dtype(dtype).kind == "b":
        return jnp.array(kind == "all")
    if kind == "sum":
        return jnp.zeros((), dtype)
    return jnp.array(_bound(np.dtype(dtype), 1 if kind == "min" else -1), dtype)


@functools.cache
def _bound(dtype: np.dtype, sign: int) -> float | int:
    if dtype.kind == "f":
        return sign * float("inf")
    limits = np.iinfo(dtype)
    return int(limits.max if sign > 0 else limits.min)
