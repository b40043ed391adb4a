"""The channels of an object's memory, and how each of them learns (paper III-F).

Every channel is shown the descriptors of the detections; the rule is in `bank`. Letters: `C`
channels of a kind (two appearances, two rings, the sources of parts), `N` detections.
"""

from __future__ import annotations

from collections.abc import Callable

import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from remind_jax.observation import Descriptors
from remind_jax.remind.memory.bank import (
    Channel,
    Permit,
    Refresh,
    Room,
    observe_one,
    observe_several,
)
from remind_jax.remind.memory.prototypes import DualBank
from remind_jax.remind.thresholds import Thresholds
from remind_jax.remind.thresholds.memory import Appearance, Background
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


def observe_appearance(
    banks: DualBank, d: Descriptors, permit: Permit, now: Array, static: Static, t: Thresholds
) -> DualBank:
    """The look of the whole object and of its typical patches (method.md#appearance-learning)."""
    a = t.appearance

    def refresh(duplicate: Array, min_quality: Array) -> Refresh:
        return Refresh(
            duplicate, a.update_margin, a.update_rate_min, a.update_rate_max, min_quality,
            by_quality=~a.gated_update,
        )  # fmt: skip

    evict = (static.appearance_evict, static.appearance_stable_evict)
    channel = Channel(
        work=refresh(a.duplicate, a.work_quality),
        stable=refresh(a.stable_duplicate, a.stable_quality),
        room=Room(
            capacity=jnp.array([static.appearance_slots] * 2),
            merge=jnp.stack([a.merge, a.stable_merge]),
            redundant=jnp.array([policy == "redundant" for policy in evict]),
            cap=a.merge_cap if static.appearance_merge == "capped" else None,
        ),
        promote_hits=a.promote_hits,
        promote_quality=a.promote_quality,
        promotes=a.promote_hits > 0,
        create_quality=a.create_quality,
        keeps_first=t.update.keep_first,
        refreshes_work=a.refresh_work,
        novel=a.novel if static.appearance_insert == "novel" else None,
    )
    quality = appearance_quality(d.patch_sum, a)
    vector, present = jnp.swapaxes(d.appearance, 0, 1), d.appearance_valid.T
    return observe_one(banks, vector, present, quality.T, permit, now, channel)


def observe_rings(
    banks: DualBank, d: Descriptors, permit: Permit, now: Array, static: Static, t: Thresholds
) -> DualBank:
    """The mean background of both rings (method.md#background-learning)."""
    b = t.background
    work, stable = _ring_refreshes(b)
    channel = Channel(
        work=work,
        stable=stable,
        room=_ring_room(static.inner_ring_slots, static.outer_ring_slots, static, b),
        promote_hits=b.promote_hits,
        promote_quality=b.promote_quality,
        create_quality=b.create_quality,
        keeps_first=t.update.keep_first,
        stable_waits=True,
    )
    quality = ring_quality(d.ring_patches, d.mask_quality, b)
    vector, present = jnp.swapaxes(d.rings, 0, 1), d.rings_valid.T & b.enabled
    return observe_one(banks, vector, present, quality.T, permit, now, channel)


def observe_parts(
    banks: DualBank, d: Descriptors, permit: Permit, now: Array, static: Static, t: Thresholds
) -> DualBank:
    """The parts of an object, one after the other (method.md#part-learning)."""
    p = t.parts
    rates = p.update_margin, p.update_rate_min, p.update_rate_max
    channel = Channel(
        work=Refresh(p.duplicate, *rates),
        stable=Refresh(p.stable_duplicate, *rates),
        room=Room(
            capacity=jnp.array([static.part_slots] * banks.work.size.shape[0]),
            merge=jnp.stack([p.merge, p.stable_merge]),
            redundant=jnp.array([static.part_evict == "redundant"] * 2),
            cap=p.merge_cap if static.part_merge == "capped" else None,
        ),
        promote_hits=p.promote_hits,
        promotes=p.promote_hits > 0,
        novel=p.novel if static.part_insert == "novel" else None,
        novel_when_full=True,
        one_to_one=p.one_to_one,
    )
    vector, present = jnp.moveaxis(d.parts, 0, 2), jnp.moveaxis(d.parts_valid, 0, 2)
    vector, present = jnp.swapaxes(vector, 0, 1), jnp.swapaxes(present, 0, 1)
    return observe_several(banks, vector, present, permit, now, channel)


def observe_ring_prototypes(
    banks: DualBank, d: Descriptors, permit: Permit, now: Array, static: Static, t: Thresholds
) -> DualBank:
    """Typical patches of both rings, one after the other (method.md#ring-prototype-learning)."""
    patches, b = d.ring_prototypes, t.background
    assert patches is not None, "there are banks for them"
    slots = static.inner_prototype_slots, static.outer_prototype_slots
    work, stable = _ring_refreshes(b)
    channel = Channel(
        work=work,
        stable=stable,
        room=_ring_room(*slots, static, b),
        promote_hits=t.ring_prototypes.promote_hits,
        stable_merge=t.ring_prototypes.stable_merge,
    )
    # [N R M ...] to [M R N ...]
    vector, present = jnp.swapaxes(patches.vector, 0, 2), jnp.swapaxes(patches.valid, 0, 2)
    return observe_several(banks, vector, present & b.enabled, permit, now, channel)


def _ring_refreshes(b: Background) -> tuple[Refresh, Refresh]:
    work = Refresh(
        b.duplicate, b.update_margin, b.update_rate_min, b.update_rate_max, b.work_quality
    )
    stable = Refresh(
        b.stable_duplicate, b.stable_margin, b.stable_rate_min, b.stable_rate_max,
        b.stable_quality, b.stable_update,
    )  # fmt: skip
    return work, stable


def _ring_room(
    inner: tuple[int, int], outer: tuple[int, int], static: Static, b: Background
) -> Room:
    return Room(
        capacity=jnp.array([inner, outer]),
        merge=jnp.stack([b.merge] * 2),
        redundant=jnp.array([static.ring_evict == "redundant"] * 2),
        cap=b.merge_cap,
    )


Observe = Callable[[DualBank, Descriptors, Permit, Array, Static, Thresholds], DualBank]
# By the name that the banks have in the state of the tracker.
CHANNELS: dict[str, Observe] = {
    "appearance": observe_appearance,
    "rings": observe_rings,
    "parts": observe_parts,
    "ring_prototypes": observe_ring_prototypes,
}
