"""How good is the observation of each detection? (method.md#observation-quality)."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from remind_jax.numerics.columns import columns
from remind_jax.numerics.pytree import pytree
from remind_jax.observation import Descriptors
from remind_jax.remind.thresholds.association import Similarity

_LEAST = (1, 1, 0, 1, 1, 0, 1, 0, 0)  # where ratings may begin, in their order


@pytree
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
    """Rates what each detection shows (method.md#observation-quality, method.md#term-weights)."""
    support = descriptors.patch_sum
    count = descriptors.num_patches.astype(support.dtype)
    density = jnp.where(count > 1e-12, jnp.clip(support / jnp.maximum(count, 1.0), 0, 1), 1.0)

    share = jnp.where(support > 0, descriptors.part_support / jnp.maximum(1.0, support), 0.0)
    num_parts = descriptors.num_parts.astype(support.dtype)
    rings = descriptors.ring_patches.astype(support.dtype)
    # What is rated, and where the rating begins and is full.
    ramps = (
        (support, t.parts_min_patches, t.parts_full_patches),
        (num_parts, t.parts_min_count, t.parts_full_count),
        (share, t.parts_min_support, t.parts_full_support),
        (rings[:, 0], t.background_min_inner, t.background_full_inner),
        (rings[:, 1], t.background_min_outer, t.background_full_outer),
        (descriptors.mask_quality, t.background_min_mask_quality, jnp.ones((), support.dtype)),
        (support, t.object_min_patches, t.object_full_patches),
        (density, t.object_min_density, t.object_full_density),
        (density, t.parts_min_density, t.parts_full_density),
    )
    values, low, high = (columns(*column) for column in zip(*ramps, strict=True))
    low = jnp.maximum(low, np.array(_LEAST, support.dtype))
    rating = jnp.moveaxis(ramp(values, low, jnp.maximum(high, low)), -1, 0)
    parts = (rating[0] + rating[1] + rating[2]) / 3.0
    background = (rating[3] + rating[4] + rating[5]) / 3.0
    rated = Quality(
        object=rating[6],
        background=jnp.clip(background, 0.0, 1.0),
        parts=jnp.where(support < t.parts_disabled_below, 0.0, jnp.clip(parts, 0.0, 1.0)),
        object_density=rating[7],
        parts_density=rating[8],
    )
    return jax.tree.map(lambda value: jnp.where(t.quality_enabled, value, 1.0), rated)
