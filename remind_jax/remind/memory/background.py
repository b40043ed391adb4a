"""What an observation does to a background ring bank (paper III-F; method.md#background-learning).

As for appearance, but prototypes move only by similarity, and a full stable bank takes nothing.
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
from remind_jax.remind.thresholds.memory import Background


def ring_quality(
    ring_patches: Int[Array, "N 2"], mask_quality: Float[Array, "N"], t: Background
) -> Float[Array, "N 2"]:
    """Quality of the inner and of the outer ring observation, [0, 1] (method.md#ring-quality)."""
    low = jnp.stack([t.inner_min_patches, t.outer_min_patches])
    high = jnp.stack([t.inner_full_patches, t.outer_full_patches])
    count = ring_patches.astype(mask_quality.dtype)
    size = jnp.clip((count - low) / jnp.maximum(high - low, 1e-12), 0.0, 1.0)
    solid = (mask_quality - t.min_mask_quality) / jnp.maximum(1.0 - t.min_mask_quality, 1e-12)
    return jnp.clip(0.7 * size + 0.3 * jnp.clip(solid, 0.0, 1.0)[:, None], 0.0, 1.0)


def observe_background(
    banks: DualBank,
    vector: Float[Array, "D"],
    present: Bool[Array, ""],
    quality: Float[Array, ""],
    permit: Permit,
    stable_capacity: Int[Array, ""],
    now: Int[Array, ""],
    t: Background,
) -> tuple[DualBank, Arrival]:
    """Shows one observation to the bank of one ring of one object.

    Args:
      banks: Work and stable bank.
      vector: Unit ring descriptor.
      present: False leaves the banks as they are.
      quality: Observation quality, [0, 1].
      permit: What the update may do.
      stable_capacity: Prototypes that the stable bank may hold.
      now: Frame.
      t: Thresholds.

    Returns:
      The banks, and the prototype that is to enter one of them.
    """
    stable_at, stable_cosine = nearest(banks.stable, vector)
    work_at, work_cosine = nearest(banks.work, vector)
    in_stable = present & (stable_cosine >= t.stable_duplicate)
    in_work = present & ~in_stable & (work_cosine >= t.duplicate)
    scale = permit.rate * quality

    def refresh(bank: Bank, at: Array, rate: Array, changes: Array, when: Array) -> Bank:
        old = entry(bank, at)
        new = dataclasses.replace(
            count_quality(old, quality),
            embedding=move_towards(old.embedding, vector, jnp.where(changes, rate, 0.0)),
            hits=old.hits + 1,
            last_seen=now,
        )
        return write(bank, at, new, when)

    stable_rate = similarity_rate(
        stable_cosine, t.stable_duplicate, t.stable_margin, t.stable_rate_min, t.stable_rate_max,
        scale,
    )  # fmt: skip
    work_rate = similarity_rate(
        work_cosine, t.duplicate, t.update_margin, t.update_rate_min, t.update_rate_max, scale
    )
    stable_changes = (quality >= t.stable_quality) & t.stable_update
    stable = refresh(banks.stable, stable_at, stable_rate, stable_changes, in_stable)
    work = refresh(banks.work, work_at, work_rate, quality >= t.work_quality, in_work)

    # A proven work prototype moves into its stable duplicate, or into the stable bank if it fits.
    moved = entry(work, work_at)
    proven = (moved.hits >= t.promote_hits) & (mean_quality(moved) >= t.promote_quality)
    twin, twin_cosine = nearest(stable, moved.embedding)
    joins = twin_cosine >= t.stable_duplicate
    leaves = in_work & permit.insert & proven & (joins | (stable.size < stable_capacity))
    joined = merge_entries(entry(stable, twin), moved, now, t.merge_cap)
    stable = write(stable, twin, joined, leaves & joins)
    work = remove(work, work_at, leaves)

    founds = present & ~in_stable & ~in_work & permit.insert & (quality >= t.create_quality)
    fresh = new_entry(vector, quality, now)
    value = jax.tree.map(lambda new, old: jnp.where(founds, new, old), fresh, moved)
    return DualBank(work, stable), Arrival(value, founds, leaves & ~joins)
