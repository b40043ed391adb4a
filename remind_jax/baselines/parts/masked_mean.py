"""One vector per detection: the mean feature of its patches.

Letters: `N` detection slots, `D` feature dimension.
"""

from __future__ import annotations

from typing import Any

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from remind_jax.numerics.pooling import are_usable, pool_patches, to_unit
from remind_jax.numerics.pytree import pytree
from remind_jax.observation import (
    AnyFeats,
    Masks,
    background_channels,
    coverage_of,
    without_coverage,
)
from remind_jax.static import Static


@pytree
class Looks:
    """What the detections of a frame look like."""

    vector: Float[Array, "N D"]  # unit length, zero where not valid
    valid: Bool[Array, "N"]
    num_bad_patches: Int[Array, ""]  # patches of the frame that are not usable


@pytree
class LookedAt:
    """A frame whose detections are known by their looks."""

    looks: Looks
    masks: Masks  # without patch coverage


def describe(
    frame_feats: AnyFeats, masks: Masks, observed: Any, *, static: Static, thresholds: Any
) -> LookedAt:
    """Looks at each detection, whatever the settings."""
    return LookedAt(look(frame_feats, masks), without_coverage(masks))


def look(frame_feats: AnyFeats, masks: Masks) -> Looks:
    """Averages patch features over each mask, in the frame or in closeups.

    Patches count by the square of their coverage, which favors those that lie inside. Patches that
    are not usable (`are_usable`) are left out; a detection without any other is not valid.
    """
    usable = are_usable(frame_feats.patches)
    is_told = usable[..., None] & ~background_channels(frame_feats)
    features = jnp.where(is_told, frame_feats.patches, 0.0)
    inside = coverage_of(frame_feats, masks)
    weights = jnp.where(masks.valid[:, None, None] & usable, inside**2, 0.0)
    mean, present = pool_patches(weights, features.astype(jnp.float32))
    return Looks(to_unit(mean), present & masks.valid, jnp.sum(~usable, dtype=jnp.int32))
