"""What typical background patches do to their banks (paper III-F).

Rule: method.md#ring-prototype-learning.

As for parts, prototypes of one observation arrive one after another and a proven work prototype
stays and keeps feeding the stable bank; a full stable bank gives up its first entry.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from remind_jax.numerics.control_flow import branch
from remind_jax.observation import RingPatches
from remind_jax.remind.memory.bank import (
    Arrival,
    Bank,
    DualBank,
    Permit,
    Room,
    append,
    closest_pair,
    entry,
    merge_entries,
    move_towards,
    nearest,
    new_entry,
    place,
    remove,
    similarity_rate,
    write,
)
from remind_jax.remind.thresholds import Thresholds
from remind_jax.remind.thresholds.memory import Background
from remind_jax.static import Static

_FIRST = 0  # entries stay in the order of their arrival


def observe_ring_prototypes(
    banks: DualBank,
    patches: RingPatches,
    permit: Permit,
    now: Int[Array, ""],
    static: Static,
    t: Thresholds,
) -> DualBank:
    """Shows the prototypes of every ring to the banks of its detection's object.

    Args:
      banks: Work and stable banks, leading axes `[R N]`.
      patches: Prototypes of each detection.
      permit: What each detection may do.
      now: Frame.
      static: Capacities and policies.
      t: Thresholds.
    """
    capacity = jnp.array([static.inner_prototype_slots, static.outer_prototype_slots])
    room = Room(
        capacity=capacity,
        merge=jnp.stack([t.background.merge] * 2),
        redundant=jnp.array([static.ring_evict == "redundant"] * 2),
        cap=t.background.merge_cap,
    )
    refresh = _over_rings(functools.partial(_refresh_work, now=now, t=t.background))
    feed = _over_rings(functools.partial(_feed_stable, now=now, t=t))
    enter = jax.vmap(jax.vmap(_enter_stable, (0, 0, 0, None)))
    join = jax.vmap(jax.vmap(functools.partial(_join_closest, now=now, t=t)))

    def show(banks: DualBank, prototype: tuple[Array, Array]):
        banks, arrival = refresh(banks, *prototype, permit)
        banks = place(banks, arrival, room, now)
        stable, value, enters = feed(banks, *prototype, permit)
        stable = enter(stable, value, enters, capacity[:, 1])
        stable = branch(jnp.any(enters), functools.partial(join, stable, enters), lambda: stable)
        return DualBank(banks.work, stable), None

    # [N R M ...] to [M R N ...]
    prototypes = (jnp.swapaxes(patches.vector, 0, 2), jnp.swapaxes(patches.valid, 0, 2))
    return jax.lax.scan(show, banks, prototypes)[0]


def _over_rings(observe: Callable[..., Any]) -> Callable[..., Any]:
    """Maps over rings and detections; what is permitted depends on the detection only."""
    return jax.vmap(jax.vmap(observe), in_axes=(0, 0, 0, None))


def _refresh_work(
    banks: DualBank,
    vector: Float[Array, "D"],
    present: Bool[Array, ""],
    permit: Permit,
    now: Int[Array, ""],
    t: Background,
) -> tuple[DualBank, Arrival]:
    """Counts a duplicate and steps towards the vector, or lets the vector in."""
    at, cosine = nearest(banks.work, vector)
    again = present & (cosine >= t.duplicate)
    rate = similarity_rate(
        cosine, t.duplicate, t.update_margin, t.update_rate_min, t.update_rate_max, permit.rate
    )
    work = _refresh(banks.work, at, vector, rate, now, again)
    value = _fresh(work, vector, now)
    founds = present & ~again & permit.insert
    return DualBank(work, banks.stable), Arrival(value, founds, jnp.zeros_like(founds))


def _feed_stable(
    banks: DualBank,
    vector: Float[Array, "D"],
    present: Bool[Array, ""],
    permit: Permit,
    now: Int[Array, ""],
    t: Thresholds,
) -> tuple[Bank, Bank, Bool[Array, ""]]:
    """Shows the work prototype now nearest to the vector, if proven, to the stable bank.

    Returns:
      The stable bank, the prototype, and whether it is to enter as a new one.
    """
    b = t.background
    at, _ = nearest(banks.work, vector)
    proven = entry(banks.work, at)
    known = banks.work.size > 0
    feeds = present & known & permit.insert & (proven.hits >= t.ring_prototypes.promote_hits)
    twin, cosine = nearest(banks.stable, proven.embedding)
    again = feeds & (cosine >= b.stable_duplicate)
    rate = similarity_rate(
        cosine, b.stable_duplicate, b.stable_margin, b.stable_rate_min, b.stable_rate_max,
        permit.rate,
    )  # fmt: skip
    rate = jnp.where(b.stable_update, rate, 0.0)
    stable = _refresh(banks.stable, twin, proven.embedding, rate, now, again)
    return stable, _fresh(stable, proven.embedding, now), feeds & ~again


def _enter_stable(
    bank: Bank, value: Bank, enters: Bool[Array, ""], capacity: Int[Array, ""]
) -> Bank:
    bank = remove(bank, jnp.int32(_FIRST), enters & (bank.size >= capacity))
    return append(bank, value, enters)


def _join_closest(bank: Bank, when: Bool[Array, ""], now: Int[Array, ""], t: Thresholds) -> Bank:
    """Joins the closest pair of a bank if it is close enough."""
    cosine, i, j, _ = closest_pair(bank)
    joins = when & (cosine >= t.ring_prototypes.stable_merge)
    joined = merge_entries(entry(bank, i), entry(bank, j), now, t.background.merge_cap)
    return remove(write(bank, i, joined, joins), j, joins)


def _refresh(
    bank: Bank,
    at: Int[Array, ""],
    vector: Float[Array, "D"],
    rate: Float[Array, ""],
    now: Int[Array, ""],
    when: Bool[Array, ""],
) -> Bank:
    old = entry(bank, at)
    embedding = move_towards(old.embedding, vector, rate)
    new = dataclasses.replace(old, embedding=embedding, hits=old.hits + 1, last_seen=now)
    return write(bank, at, new, when)


def _fresh(bank: Bank, vector: Float[Array, "D"], now: Int[Array, ""]) -> Bank:
    return new_entry(vector, jnp.ones((), bank.quality_sum.dtype), now)
