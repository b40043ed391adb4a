"""What the parts of a detection do to a part bank (paper III-F; method.md#part-learning).

Parts arrive one after another. A proven work prototype stays and keeps feeding the stable bank.
"""

from __future__ import annotations

import dataclasses

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from remind_jax.remind.memory.bank import (
    Arrival,
    Bank,
    DualBank,
    Permit,
    entry,
    move_towards,
    nearest,
    new_entry,
    similarities,
    similarity_rate,
    write,
)
from remind_jax.remind.thresholds.memory import Parts
from remind_jax.static import Static


def observe_part(
    banks: DualBank,
    used: Bool[Array, "S"],
    vector: Float[Array, "D"],
    present: Bool[Array, ""],
    permit: Permit,
    now: Int[Array, ""],
    static: Static,
    t: Parts,
) -> tuple[DualBank, Bool[Array, "S"], Arrival]:
    """Shows one part of a detection to one part channel of one object.

    Args:
      banks: Work and stable bank.
      used: Work prototypes that earlier parts of the same detection refreshed.
      vector: Unit descriptor.
      present: False leaves the banks as they are.
      permit: What the update may do.
      now: Frame.
      static: Policy of insertion.
      t: Thresholds.

    Returns:
      The banks, `used`, and the prototype that is to enter one of the banks.
    """
    at, cosine = _choose(banks.work, vector, used, t)
    again = present & (cosine >= t.duplicate)
    work = _refresh(banks.work, at, cosine, vector, t.duplicate, permit, now, t, again)
    used = used | (again & (jnp.arange(used.shape[0]) == at))

    proven = entry(work, at)
    feeds = again & permit.insert & (t.promote_hits > 0) & (proven.hits >= t.promote_hits)
    twin, twin_cosine = nearest(banks.stable, proven.embedding)
    known = twin_cosine >= t.stable_duplicate
    stable = _refresh(
        banks.stable, twin, twin_cosine, proven.embedding, t.stable_duplicate, permit, now, t,
        feeds & known,
    )  # fmt: skip

    founds = present & ~again & permit.insert
    if static.part_insert == "novel":
        founds = founds & ((work.size < static.part_slots[0]) | (cosine <= t.novel))
    entering = jnp.where(founds, vector, proven.embedding)
    value = new_entry(entering, jnp.ones((), work.quality_sum.dtype), now)
    return DualBank(work, stable), used, Arrival(value, founds, feeds & ~known)


def _choose(
    work: Bank, vector: Float[Array, "D"], used: Bool[Array, "S"], t: Parts
) -> tuple[Int[Array, ""], Float[Array, ""]]:
    """The most similar prototype, avoiding those that this detection refreshed already."""
    cosine = similarities(work, vector)
    best = jnp.argmax(cosine)
    free = jnp.where(used, -jnp.inf, cosine)
    other = jnp.argmax(free)
    redirect = t.one_to_one & used[best] & (work.size > 1) & jnp.isfinite(free[other])
    at = jnp.where(redirect, other, best)
    return at, cosine[at]


def _refresh(
    bank: Bank,
    at: Int[Array, ""],
    cosine: Float[Array, ""],
    vector: Float[Array, "D"],
    duplicate: Float[Array, ""],
    permit: Permit,
    now: Int[Array, ""],
    t: Parts,
    when: Bool[Array, ""],
) -> Bank:
    """Counts a hit and steps towards the vector by similarity (method.md#similarity-step)."""
    old = entry(bank, at)
    rate = similarity_rate(
        cosine, duplicate, t.update_margin, t.update_rate_min, t.update_rate_max, permit.rate
    )
    new = dataclasses.replace(
        old,
        embedding=move_towards(old.embedding, vector, rate),
        hits=old.hits + 1,
        last_seen=now,
    )
    return write(bank, at, new, when)
