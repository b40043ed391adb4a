"""Masked pooling of patch features; objects, parts and rings all go through it (paper III-B).

Letters: `N` detections, `P` patches, `D` dimensions.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

TINY = 1e-12
MAX_FEATURE = 1e15  # squares of larger ones may not add up in 32 bits


def are_usable(features: Float[Array, "... D"]) -> Bool[Array, "..."]:
    """Patches whose features are all finite, and small enough to be squared."""
    return jnp.all(jnp.abs(features) < MAX_FEATURE, axis=-1)


def to_unit(vectors: Float[Array, "... D"]) -> Float[Array, "... D"]:
    """Scales vectors to unit length; a vector shorter than 1e-12 becomes zero."""
    norm = jnp.sqrt(jnp.sum(vectors * vectors, axis=-1, keepdims=True))
    return jnp.where(norm < TINY, 0.0, vectors / jnp.maximum(norm, TINY))


def dot(left: Float[Array, "... I D"], right: Float[Array, "... J D"]) -> Float[Array, "... I J"]:
    """All inner products at full float32 precision on every device."""
    return jnp.einsum("...id,...jd->...ij", left, right, precision="highest")


def pool(
    weights: Float[Array, "... P"], features: Float[Array, "P D"]
) -> tuple[Float[Array, "... D"], Bool[Array, "..."]]:
    """Weighted mean of the features of a region, zero if it is empty, and whether it is not."""
    total = jnp.sum(weights, axis=-1)
    present = total > TINY
    sums = jnp.einsum("...p,pd->...d", weights, features, precision="highest")
    mean = sums / jnp.where(present, total, 1.0)[..., None]
    return jnp.where(present[..., None], mean, 0.0), present


def pool_patches(
    weights: Float[Array, "N Hp Wp"], features: Float[Array, "*#N Hp Wp D"]
) -> tuple[Float[Array, "N D"], Bool[Array, "N"]]:
    """`pool` on a grid of patches: one that all regions share, or each region's own."""
    flat = features.reshape(*features.shape[:-3], -1, features.shape[-1])
    weights = weights.reshape(len(weights), -1)
    return pool(weights, flat) if flat.ndim == 2 else jax.vmap(pool)(weights, flat)


def keep_typical(
    features: Float[Array, "P D"],
    mean: Float[Array, "N D"],
    members: Bool[Array, "N P"],
    share: Float[Array, ""],
    min_patches: Int[Array, ""],
) -> Bool[Array, "N P"]:
    """Picks the patches of each object that are most like its mean (method.md#object-descriptors).

    Args:
      mean: Weighted mean feature of each object, not normalized.
      share: Share of the patches to keep; outside (0, 1] all are kept.
      min_patches: Objects with fewer patches keep all.

    Returns:
      The kept patches; among equally typical ones the first in raster order.
    """
    norm = jnp.sqrt(jnp.sum(features * features, axis=-1))
    mean_norm = jnp.sqrt(jnp.sum(mean * mean, axis=-1, keepdims=True))
    similarity = dot(mean, features) / (norm[None] * mean_norm + TINY)
    similarity = jnp.where(mean_norm > TINY, similarity, 0.0)

    count = jnp.sum(members, axis=-1)
    share = jnp.where((share > 0) & (share <= 1), share, 1.0)
    wanted = jnp.maximum(1, jnp.ceil(share * count).astype(jnp.int32))
    wanted = jnp.where(count < min_patches, count, jnp.minimum(wanted, count))
    return members & is_largest(similarity, members, wanted)


def is_largest(
    values: Float[Array, "N P"], members: Bool[Array, "N P"], wanted: Int[Array, "N"]
) -> Bool[Array, "N P"]:
    """Marks the `wanted` largest member values of each row, the first among equals.

    Finds the smallest kept value bit by bit on order-preserving integers: exact, and faster than
    sorting whole patch grids.
    """
    bits = jax.lax.bitcast_convert_type(values.astype(jnp.float32), jnp.int32)
    key = jnp.where(bits < 0, bits ^ jnp.int32(0x7FFFFFFF), bits)
    key = jax.lax.bitcast_convert_type(key, jnp.uint32) ^ jnp.uint32(0x80000000)
    key = jnp.where(members, key, jnp.uint32(0))

    def lower_bit(step: Int[Array, ""], bound: Array) -> Array:
        trial = bound | (jnp.uint32(1) << jnp.uint32(31 - step))
        enough = jnp.sum(key >= trial[:, None], axis=-1) >= wanted
        return jnp.where(enough, trial, bound)

    bound = jax.lax.fori_loop(0, 32, lower_bit, jnp.zeros(key.shape[0], jnp.uint32))[:, None]
    above, equal = key > bound, (key == bound) & members
    room = wanted - jnp.sum(above, axis=-1)
    return above | (equal & (jnp.cumsum(equal, axis=-1) <= room[:, None]))
