"""The channels of an object's memory, and how each of them learns (paper III-F).

Every channel is shown the descriptors of the detections; the rule is in `bank`. Letters: `C`
channels of a kind (two appearances, two rings, the sources of parts), `N` detections.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from remind_jax.numerics.rounding import divide
from remind_jax.observation import Descriptors
from remind_jax.remind.memory.bank import (
    Channel,
    Observation,
    Permit,
    Refresh,
    Room,
    observe_several,
    observe_whole,
    side_by_side,
)
from remind_jax.remind.memory.prototypes import Bank
from remind_jax.remind.thresholds import Thresholds
from remind_jax.remind.thresholds.memory import Appearance, Background, Parts
from remind_jax.static import Static

GLOBAL, TRIMMED = 0, 1
_TRIMMED_BASE = 0.1  # quality of the typical patches of an object of quality 0


def appearance_quality(patch_sum: Float[Array, "N"], t: Appearance) -> Float[Array, "N 2"]:
    """Quality of the global and of the trimmed observation, [0, 1]."""
    span = t.patches_full - t.patches_min
    ramp = divide(patch_sum - t.patches_min, jnp.where(span > 0, span, 1.0))
    ramp = jnp.clip(ramp, 0.0, 1.0)
    quality = jnp.where(span > 0, ramp, (patch_sum >= t.patches_full).astype(ramp.dtype))
    trimmed = jnp.minimum(1.0, _TRIMMED_BASE + (1.0 - _TRIMMED_BASE) * quality)
    return jnp.stack([quality, trimmed], axis=-1)


def ring_quality(
    ring_patches: Int[Array, "N 2"], mask_quality: Float[Array, "N"], t: Background
) -> Float[Array, "N 2"]:
    """Quality of the inner and of the outer ring observation, [0, 1] (method.md#ring-quality)."""
    low = jnp.stack([t.inner_min_patches, t.outer_min_patches])
    high = jnp.stack([t.inner_full_patches, t.outer_full_patches])
    count = ring_patches.astype(mask_quality.dtype)
    size = jnp.clip(divide(count - low, jnp.maximum(high - low, 1e-12)), 0.0, 1.0)
    solid = mask_quality - t.min_mask_quality
    solid = divide(solid, jnp.maximum(1.0 - t.min_mask_quality, 1e-12))
    return jnp.clip(0.7 * size + 0.3 * jnp.clip(solid, 0.0, 1.0)[:, None], 0.0, 1.0)


def observe_wholes(
    banks: Bank, d: Descriptors, permit: Permit, now: Array, static: Static, t: Thresholds
) -> Bank:
    """The look of the whole object and of its typical patches, and the mean of both rings."""
    of_look = appearance_quality(d.patch_sum, t.appearance)
    of_rings = ring_quality(d.ring_patches, d.mask_quality, t.background)
    quality = jnp.concatenate([of_look, of_rings], axis=1)
    vector = jnp.concatenate([d.appearance, d.rings], axis=1)
    present = jnp.concatenate([d.appearance_valid, d.rings_valid & t.background.enabled], axis=1)
    looks = [_appearance_channel(static, t.appearance, t.update.keep_first)] * 2
    rings = _ring_channels(static, t.background, t.update.keep_first)
    channel = side_by_side(*looks, *rings)
    seen = Observation(jnp.swapaxes(vector, 0, 1), present.T, quality.T, permit)
    return observe_whole(banks, seen, now, channel)


def _appearance_channel(static: Static, a: Appearance, keeps_first: Bool[Array, ""]) -> Channel:
    """How the look of an object is learned (method.md#appearance-learning)."""
    s = static.switches
    gives_up = s.appearance_evict, s.appearance_stable_evict
    return Channel(
        refresh=_refresh(
            a,
            min_quality=(a.work_quality, a.stable_quality),
            by_quality=(~a.gated_update, ~a.gated_update),
        ),
        room=_room(s.appearance_slots, (a.merge, a.stable_merge), *gives_up),
        cap=a.merge_cap if s.appearance_merge == "capped" else 1,
        promote_hits=a.promote_hits,
        promote_quality=a.promote_quality,
        promotes=a.promote_hits > 0,
        create_quality=a.create_quality,
        keeps_first=keeps_first,
        refreshes_work=a.refresh_work,
        novel=a.novel if s.appearance_insert == "novel" else jnp.inf,
    )


def _ring_channels(static: Static, b: Background, keeps_first: Bool[Array, ""]) -> list[Channel]:
    """How the mean background of both rings is learned (method.md#background-learning)."""
    return [
        Channel(
            refresh=_ring_refresh(b),
            room=_ring_room(slots, static, b),
            cap=b.merge_cap,
            promote_hits=b.promote_hits,
            promote_quality=b.promote_quality,
            create_quality=b.create_quality,
            keeps_first=keeps_first,
            stable_waits=True,
        )
        for slots in (static.switches.inner_ring_slots, static.switches.outer_ring_slots)
    ]


def observe_parts(
    banks: Bank, d: Descriptors, permit: Permit, now: Array, static: Static, t: Thresholds
) -> Bank:
    """The parts of an object, one after the other (method.md#part-learning)."""
    p, s = t.parts, static.switches
    channel = Channel(
        refresh=_refresh(p),
        room=_room(s.part_slots, (p.merge, p.stable_merge), s.part_evict, s.part_evict),
        cap=p.merge_cap if s.part_merge == "capped" else 1,
        promote_hits=p.promote_hits,
        promotes=p.promote_hits > 0,
        novel=p.novel if s.part_insert == "novel" else jnp.inf,
        one_to_one=p.one_to_one,
    )
    # [N C K ...] to [K C N ...]
    vector, present = jnp.swapaxes(d.parts, 0, 2), jnp.swapaxes(d.parts_valid, 0, 2)
    channels = [channel] * banks.size.shape[1]
    return observe_several(banks, vector, present, permit, now, channels)


def observe_ring_prototypes(
    banks: Bank, d: Descriptors, permit: Permit, now: Array, static: Static, t: Thresholds
) -> Bank:
    """Typical patches of both rings, one after the other (method.md#ring-prototype-learning)."""
    patches, b = d.ring_prototypes, t.background
    assert patches is not None, "there are banks for them"
    channels = [
        Channel(
            refresh=_ring_refresh(b),
            room=_ring_room(slots, static, b),
            cap=b.merge_cap,
            promote_hits=t.ring_prototypes.promote_hits,
        )
        for slots in (static.switches.inner_prototype_slots, static.switches.outer_prototype_slots)
    ]
    # [N R M ...] to [M R N ...]
    vector, present = jnp.swapaxes(patches.vector, 0, 2), jnp.swapaxes(patches.valid, 0, 2)
    return observe_several(
        banks, vector, present & b.enabled, permit, now, 
        channels, t.ring_prototypes.stable_merge,
    )  # fmt: skip


def _refresh(t: Appearance | Parts, **more: Any) -> Refresh:
    """Both banks follow what they resemble by the same steps."""
    return Refresh(
        duplicate=(t.duplicate, t.stable_duplicate),
        margin=(t.update_margin, t.update_margin),
        rate_min=(t.update_rate_min, t.update_rate_min),
        rate_max=(t.update_rate_max, t.update_rate_max),
        **more,
    )


def _ring_refresh(b: Background) -> Refresh:
    return Refresh(
        duplicate=(b.duplicate, b.stable_duplicate),
        margin=(b.update_margin, b.stable_margin),
        rate_min=(b.update_rate_min, b.stable_rate_min),
        rate_max=(b.update_rate_max, b.stable_rate_max),
        min_quality=(b.work_quality, b.stable_quality),
        moves=(True, b.stable_update),
    )


def _room(capacity: tuple[int, int], merge: tuple[Array, Array], *gives_up: str) -> Room:
    return Room(capacity, merge, tuple(what == "redundant" for what in gives_up))


def _ring_room(capacity: tuple[int, int], static: Static, b: Background) -> Room:
    gives_up = static.switches.ring_evict
    return _room(capacity, (b.merge, b.merge), gives_up, gives_up)


Observe = Callable[[Bank, Descriptors, Permit, Array, Static, Thresholds], Bank]
# By the name that the banks have in the state of the tracker.
CHANNELS: dict[str, Observe] = {
    "wholes": observe_wholes,
    "parts": observe_parts,
    "ring_prototypes": observe_ring_prototypes,
}
