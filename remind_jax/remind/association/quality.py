"""How good is the observation of each detection? (method.md#observation-quality)."""

from __future__ import annotations

import dataclasses

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from remind_jax.observation import Descriptors
from remind_jax.remind.thresholds.association import Similarity


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Quality:
    """Quality of what was observed, each in [0, 1]; it does not depend on the object."""

    object: Float[Array, "N"]
    background: Float[Array, "N"]
    parts: Float[Array, "N"]
    object_density: Float[Array, "N"]  # 0 for masks that barely cover their patches
    parts_density: Float[Array, "N"]


def ramp(x: Array, low: Array, high: Array) -> Array:
    """Rises from 0 at `low` to 1 at `high`; a step at `low` if `high` is not above it."""
    slope = (x - low) / jnp.where(high > low, high - low, 1.0)
    return jnp.where(high > low, jnp.clip(slope, 0.0, 1.0), (x >= high).astype(slope.dtype))


def assess(descriptors: Descriptors, t: Similarity) -> Quality:
    """Rates object, background and parts of every detection.

    Rules: method.md#observation-quality, method.md#term-weights.
    """
    support = descriptors.patch_sum
    count = descriptors.num_patches.astype(support.dtype)
    density = jnp.where(count > 1e-12, jnp.clip(support / jnp.maximum(count, 1.0), 0, 1), 1.0)

    def bounded(x: Array, low: Array, high: Array, floor: float) -> Array:
        low = jnp.maximum(low, floor)
        return ramp(x, low, jnp.maximum(high, low))

    share = jnp.where(support > 0, descriptors.part_support / jnp.maximum(1.0, support), 0.0)
    parts = (
        bounded(support, t.parts_min_patches, t.parts_full_patches, 1.0)
        + bounded(
            descriptors.num_parts.astype(support.dtype), t.parts_min_count, t.parts_full_count, 1.0
        )
        + bounded(share, t.parts_min_support, t.parts_full_support, 0.0)
    ) / 3.0
    rings = descriptors.ring_patches.astype(support.dtype)
    background = (
        bounded(rings[:, 0], t.background_min_inner, t.background_full_inner, 1.0)
        + bounded(rings[:, 1], t.background_min_outer, t.background_full_outer, 1.0)
        + bounded(descriptors.mask_quality, t.background_min_mask_quality, jnp.ones(()), 0.0)
    ) / 3.0
    rated = Quality(
        object=bounded(support, t.object_min_patches, t.object_full_patches, 1.0),
        background=jnp.clip(background, 0.0, 1.0),
        parts=jnp.where(support < t.parts_disabled_below, 0.0, jnp.clip(parts, 0.0, 1.0)),
        object_density=bounded(density, t.object_min_density, t.object_full_density, 0.0),
        parts_density=bounded(density, t.parts_min_density, t.parts_full_density, 0.0),
    )
    return jax.tree.map(lambda value: jnp.where(t.quality_enabled, value, 1.0), rated)
