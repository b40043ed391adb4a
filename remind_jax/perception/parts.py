"""Parts of an object: clusters of its patches, pooled and merged (perception notes 5.1).

Letters: `N` detections, `P` patches, `K` clusters, `D` dimensions.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from remind_jax.config.static import Static
from remind_jax.config.thresholds import Perception
from remind_jax.perception.pooling import TINY, dot, pool, to_unit
from remind_jax.solvers.clustering import kmeans


def cluster_parts(
    features: Float[Array, "P D"],
    coverage: Float[Array, "N P"],
    members: Bool[Array, "N P"],
    static: Static,
    thresholds: Perception,
) -> tuple[Float[Array, "N K D"], Bool[Array, "N K"], Float[Array, "N K"]]:
    """Describes each object by up to K parts of differing appearance.

    Patches are clustered by direction, parts are pooled from the raw features. A part that
    resembles a better supported one is dropped.

    Returns:
      Unit vectors by falling support, which of them exist, and their summed coverage.
    """
    norm = jnp.sqrt(jnp.sum(features * features, axis=-1, keepdims=True)) + TINY
    labels = kmeans(
        features / norm,
        members & thresholds.parts_enabled,
        clusters=static.part_clusters,
        iterations=static.part_iterations,
        restarts=static.part_restarts,
        seed=static.part_seed,
        solver=static.solver,
    )
    inside = labels[:, None, :] == jnp.arange(static.part_clusters)[:, None]
    weights = jnp.where(inside, coverage[:, None, :], 0.0)
    support = jnp.sum(weights, axis=-1)
    mean, present = pool(weights, features)

    size = jnp.sum(inside, axis=-1)
    # An object that is one cluster is one part by itself and is spared the test of size.
    count = jnp.sum(members, axis=-1, keepdims=True)
    alone = jnp.minimum(count, static.part_clusters) == 1
    large = (size >= thresholds.part_min_patches) & (support >= thresholds.part_min_support)
    valid = present & (large | (alone & (size > 0)))
    return _drop_resembling(to_unit(mean), valid, support, thresholds.part_merge)


def _drop_resembling(
    parts: Float[Array, "N K D"],
    valid: Bool[Array, "N K"],
    support: Float[Array, "N K"],
    merge: Float[Array, ""],
) -> tuple[Float[Array, "N K D"], Bool[Array, "N K"], Float[Array, "N K"]]:
    """Visits parts by falling support and keeps those unlike all that were kept before."""
    order = jnp.argsort(jnp.where(valid, -support, jnp.inf), axis=-1, stable=True)

    def sort(values: Array) -> Array:  # by whatever `order` is
        index = order.reshape(order.shape + (1,) * (values.ndim - 2))
        return jnp.take_along_axis(values, index, axis=1)

    parts, valid, support = sort(parts), sort(valid), sort(support)
    similarity = dot(parts, parts).astype(merge.dtype)

    def visit(rank: Int[Array, ""], kept: Bool[Array, "N K"]) -> Bool[Array, "N K"]:
        earlier = kept & (jnp.arange(kept.shape[1]) < rank)
        closest = jnp.max(jnp.where(earlier, similarity[:, rank], -jnp.inf), axis=-1)
        return kept.at[:, rank].set(valid[:, rank] & (closest <= merge))

    kept = jax.lax.fori_loop(0, valid.shape[1], visit, valid)
    parts, support = jnp.where(kept[..., None], parts, 0.0), jnp.where(kept, support, 0.0)
    order = jnp.argsort(~kept, axis=-1, stable=True)
    return sort(parts), sort(kept), sort(support)
