"""What an observation does to an appearance bank (paper III-F; method.md#appearance-learning).

A stable duplicate refreshes the stable bank and hides the work bank; else a work duplicate is
refreshed and, once proven, moves to the stable bank; else the observation founds a prototype.
"""

from __future__ import annotations

import dataclasses

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from remind_jax.remind.memory.bank import (
    Arrival,
    Bank,
    DualBank,
    Permit,
    count_quality,
    entry,
    mean_quality,
    merge_entries,
    move_towards,
    nearest,
    new_entry,
    remove,
    similarity_rate,
    write,
)
from remind_jax.remind.thresholds.memory import Appearance
from remind_jax.static import Static

GLOBAL, TRIMMED = 0, 1


def appearance_quality(patch_sum: Float[Array, "N"], t: Appearance) -> Float[Array, "N 2"]:
    """Quality of the global and of the trimmed observation, [0, 1].

    Args:
      patch_sum: Effective patches of each detection.
      t: Thresholds of the appearance banks.
    """
    span = t.patches_full - t.patches_min
    ramp = jnp.clip((patch_sum - t.patches_min) / jnp.where(span > 0, span, 1.0), 0.0, 1.0)
    quality = jnp.where(span > 0, ramp, (patch_sum >= t.patches_full).astype(ramp.dtype))
    trimmed = jnp.minimum(1.0, t.trimmed_base + (1.0 - t.trimmed_base) * quality)
    return jnp.stack([quality, trimmed], axis=-1)


def observe_appearance(
    banks: DualBank,
    vector: Float[Array, "D"],
    present: Bool[Array, ""],
    quality: Float[Array, ""],
    permit: Permit,
    now: Int[Array, ""],
    static: Static,
    t: Appearance,
) -> tuple[DualBank, Arrival]:
    """Shows one observation to one appearance channel of one object.

    Args:
      banks: Work and stable bank.
      vector: Unit descriptor.
      present: False leaves the banks as they are.
      quality: Observation quality, [0, 1].
      permit: What the update may do.
      now: Frame.
      static: Policies of insertion and merging.
      t: Thresholds.

    Returns:
      The banks, and the prototype that is to enter one of them.
    """
    stable_at, stable_cosine = nearest(banks.stable, vector)
    work_at, work_cosine = nearest(banks.work, vector)
    in_stable = present & (stable_cosine >= t.stable_duplicate)
    in_work = present & ~in_stable & (work_cosine >= t.duplicate)
    again = in_work & t.refresh_work

    def refresh(
        bank: Bank, at: Array, cosine: Array, duplicate: Array, least: Array, when: Array
    ) -> Bank:
        gated = similarity_rate(
            cosine, duplicate, t.update_margin, t.update_rate_min, t.update_rate_max,
            permit.rate * quality,
        )  # fmt: skip
        rate = jnp.where(t.gated_update, gated, quality)
        rate = jnp.where(quality >= least, rate, 0.0)
        old = entry(bank, at)
        new = dataclasses.replace(
            count_quality(old, quality),
            embedding=move_towards(old.embedding, vector, rate),
            hits=old.hits + 1,
            last_seen=now,
        )
        return write(bank, at, new, when)

    stable = refresh(
        banks.stable, stable_at, stable_cosine, t.stable_duplicate, t.stable_quality, in_stable
    )
    work = refresh(banks.work, work_at, work_cosine, t.duplicate, t.work_quality, again)

    # A proven work prototype moves into the stable bank, or into its duplicate there
    # (method.md#bank-promotion).
    moved = entry(work, work_at)
    proven = (moved.hits >= t.promote_hits) & (mean_quality(moved) >= t.promote_quality)
    leaves = again & permit.insert & (t.promote_hits > 0) & proven
    twin, twin_cosine = nearest(stable, moved.embedding)
    joins = twin_cosine >= t.stable_duplicate
    cap = t.merge_cap if static.appearance_merge == "capped" else None
    joined = merge_entries(entry(stable, twin), moved, now, cap)
    stable = write(stable, twin, joined, leaves & joins)
    work = remove(work, work_at, leaves)

    founds = present & ~in_stable & ~in_work & permit.insert & (quality >= t.create_quality)
    if static.appearance_insert == "novel":
        founds = founds & (jnp.maximum(stable_cosine, work_cosine) <= t.novel)
    fresh = new_entry(vector, quality, now)
    value = jax.tree.map(lambda new, old: jnp.where(founds, new, old), fresh, moved)
    return DualBank(work, stable), Arrival(value, founds, leaves & ~joins)
