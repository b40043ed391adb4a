"""Overlap of boxes. Letters: `N` and `M` boxes: left, top, right, bottom."""

from __future__ import annotations

import jax.numpy as jnp
from jaxtyping import Array, Float


def box_iou(first: Float[Array, "N 4"], second: Float[Array, "M 4"]) -> Float[Array, "N M"]:
    """Intersection over union of every two boxes; 0 for boxes without area."""
    corner = jnp.maximum(first[:, None, :2], second[None, :, :2])
    opposite = jnp.minimum(first[:, None, 2:], second[None, :, 2:])
    common = jnp.prod(jnp.maximum(opposite - corner, 0), axis=-1)
    areas = [jnp.prod(jnp.maximum(box[:, 2:] - box[:, :2], 0), axis=-1) for box in (first, second)]
    union = areas[0][:, None] + areas[1][None] - common
    return jnp.where(union > 0, common / jnp.where(union > 0, union, 1.0), 0.0)
