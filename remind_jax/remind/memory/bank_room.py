"""How a full bank makes room: by a merge, or by giving up a prototype (method.md#bank-room)."""

from __future__ import annotations

import dataclasses

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from remind_jax.numerics.columns import columns
from remind_jax.numerics.pooling import to_unit
from remind_jax.remind.memory.prototypes import (
    Bank,
    Edit,
    closest_pair,
    count,
    entries,
    live,
    mean_quality,
)

_TIE = 1e-6


def make_room(
    bank: Bank,
    merge: Float[Array, ""],
    redundant: Bool[Array, ""],
    cap: Int[Array, ""],
    *,
    now: Int[Array, ""],
) -> Edit:
    """Frees one slot: joins the closest pair, or gives up the weakest prototype."""
    cosine, i, j, all_cosines = closest_pair(bank)
    joins = cosine >= merge
    left, right = entries(bank, i, j)
    joined = merge_entries(left, right, now, cap)
    gone = jnp.where(joins, j, weakest(bank, all_cosines, cosine, redundant))
    return Edit(i, joined, joins, gone, jnp.ones_like(joins))


def weakest(
    bank: Bank,
    cosine: Float[Array, "S S"],
    closest: Float[Array, ""],
    redundant: Bool[Array, ""],
) -> Int[Array, ""]:
    """The prototype to give up: the least recently seen of all, or of the most redundant ones.

    method.md#bank-room; the first among equals. The cosine is -1 where there is no pair.
    """
    alive = live(bank)
    others = jnp.where(jnp.eye(alive.shape[0], dtype=bool), -1.0, cosine)
    redundancy = jnp.max(others, axis=1)
    redundancy, top = (jnp.where(one > -1.0, one, 0.0) for one in (redundancy, closest))
    alive = alive & (~redundant | (jnp.abs(redundancy - top) < _TIE))
    oldest = jnp.argmin(jnp.where(alive, bank.last_seen, jnp.iinfo(jnp.int32).max))
    return oldest.astype(jnp.int32)


def merge_entries(left: Bank, right: Bank, now: Int[Array, ""], cap: Int[Array, ""]) -> Bank:
    """Joins two prototypes by their hits, up to `cap` (method.md#prototype-merge)."""
    weights = [
        jnp.minimum(side.hits, jnp.maximum(1, cap)).astype(jnp.float32) for side in (left, right)
    ]
    seen = jnp.maximum(jnp.maximum(left.last_seen, right.last_seen), now)
    total = left.quality_sum + right.quality_sum
    joined = Bank(
        embedding=to_unit(weights[0] * left.embedding + weights[1] * right.embedding),
        counts=count(left.hits + right.hits, seen, left.num_qualities + right.num_qualities),
        qualities=columns(total, total),
        size=left.size,
    )
    return dataclasses.replace(joined, qualities=columns(mean_quality(joined), total))
