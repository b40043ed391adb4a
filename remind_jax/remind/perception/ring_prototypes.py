"""Typical patches of each ring: clusters, joined where alike (method.md#ring-prototypes).

Letters: `N` detections, `R = 2` rings (inner, outer), `P` patches, `K` clusters, `M` prototypes
kept, `D` dimensions.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from remind_jax.numerics.pooling import TINY, dot
from remind_jax.numerics.reductions import connect
from remind_jax.numerics.rounding import unit
from remind_jax.observation import RingPatches
from remind_jax.remind.thresholds.perception import RingPrototypes
from remind_jax.solvers.clustering import kmeans
from remind_jax.static import Static

_ROUNDING = 5e-7  # of float32 inner products of unit vectors


def find_ring_prototypes(
    features: Float[Array, "P D"],
    rings: Bool[Array, "N R P"],
    weights: Float[Array, "N R P"],
    static: Static,
    t: RingPrototypes,
) -> RingPatches:
    """Describes each ring by the patches that stand for its largest and most uniform regions.

    Weights are the share of each ring patch that is background.
    """
    norm = jnp.sqrt(jnp.sum(features * features, axis=-1, keepdims=True)) + TINY
    points, seed = features / norm, static.switches.ring_seed
    found = [
        _describe_ring(points, rings[:, ring], weights[:, ring], seed + ring, static, t)
        for ring in range(rings.shape[1])
    ]
    vectors, valid = (jnp.stack(leaves, axis=1) for leaves in zip(*found, strict=True))
    return RingPatches(vectors, valid)


def _describe_ring(
    points: Float[Array, "P D"],
    members: Bool[Array, "N P"],
    weights: Float[Array, "N P"],
    seed: int,
    static: Static,
    t: RingPrototypes,
) -> tuple[Float[Array, "N M D"], Bool[Array, "N M"]]:
    """Prototypes of one ring of every detection."""
    clusters = max(static.switches.ring_clusters)
    wanted = _count_clusters(jnp.sum(members, axis=1), static, t)
    labels, centers = kmeans(
        points,
        members,
        wanted,
        clusters=clusters,
        iterations=static.switches.ring_iterations,
        restarts=static.switches.ring_restarts,
        seed=seed,
        solver=static.solver,
    )
    # A ring without any background in its patches counts them whole.
    weightless = jnp.sum(jnp.where(members, weights, 0.0), axis=1, keepdims=True) <= TINY
    weights = jnp.where(weightless, 1.0, weights)
    inside = labels[:, None] == jnp.arange(clusters)[:, None]
    root = _join_alike(centers, jnp.any(inside, axis=2), t.joined)

    # Regions are indexed by their first cluster.
    region = (root[:, None] == jnp.arange(clusters)[:, None]).astype(points.dtype)
    sizes = jnp.sum(inside, axis=2).astype(points.dtype)
    masses = jnp.sum(jnp.where(inside, weights[:, None], 0.0), axis=2)
    sums = dot(inside.astype(points.dtype), points.T)
    heavy = dot(jnp.where(inside, weights[:, None], 0.0), points.T)
    size, mass = (
        jnp.einsum("ngk,nk->ng", region, leaf, precision="highest") for leaf in (sizes, masses)
    )
    sums, heavy = (
        jnp.einsum("ngk,nkd->ngd", region, leaf, precision="highest") for leaf in (sums, heavy)
    )

    weighs = (mass > TINY)[..., None]
    center = jnp.where(
        weighs,
        heavy / jnp.where(weighs, mass[..., None], 1.0),
        sums / jnp.maximum(size, 1.0)[..., None],
    )
    center = unit(center)
    cohesion = jnp.sum(sums * center, axis=-1) / jnp.maximum(size, 1.0)
    chosen, valid = _choose_regions(mass, cohesion, size > 0, static, t)

    vectors = jnp.take_along_axis(center, chosen[..., None], axis=1)
    if static.switches.ring_prototype_kind == "medoid":
        at = jnp.take_along_axis(root, jnp.maximum(labels, 0), axis=1)
        is_inside = (at[:, None] == chosen[..., None]) & members[:, None]
        vectors = _take_nearest(points, vectors, is_inside, labels)
    # A ring that is not split is described by the mean of its patches, whatever their weight.
    whole = unit(sums[:, 0] / jnp.maximum(size[:, 0], 1.0)[:, None])
    first = jnp.arange(valid.shape[1]) == 0
    single = (wanted <= 1)[:, None]
    valid = jnp.where(single, first & jnp.any(members, axis=1, keepdims=True), valid)
    vectors = jnp.where(single[..., None], whole[:, None], vectors)
    return jnp.where(valid[..., None], vectors, 0.0), valid


def _count_clusters(count: Int[Array, "N"], static: Static, t: RingPrototypes) -> Int[Array, "N"]:
    """Clusters that a ring of so many patches is split into, at least 1."""
    patches = count.astype(t.cluster_scale.dtype)
    if static.switches.ring_cluster_rule == "root":
        ideal = jnp.maximum(t.cluster_scale, 0.01) * jnp.sqrt(patches)
    else:
        ideal = patches / jnp.maximum(t.patches_per_cluster, 1.0)
    least, most = static.switches.ring_clusters
    number = jnp.clip(jnp.round(ideal).astype(jnp.int32), least, max(least, most))
    room = jnp.maximum(1, count // jnp.maximum(t.min_cluster_patches, 1))
    return jnp.maximum(1, jnp.minimum(number, room)).astype(jnp.int32)


def _join_alike(
    centers: Float[Array, "N K D"], exists: Bool[Array, "N K"], joined: Float[Array, ""]
) -> Int[Array, "N K"]:
    """First cluster of the region that each cluster belongs to; a missing one is its own.

    Clusters are in one region if a chain of similar ones leads from one to the other.
    """
    direction = unit(centers)
    cosine = dot(direction, direction).astype(joined.dtype)
    both = exists[:, :, None] & exists[:, None]
    reach = jax.vmap(connect)((cosine > joined) & both)
    return jnp.argmax(reach, axis=2).astype(jnp.int32)


def _choose_regions(
    mass: Float[Array, "N K"],
    cohesion: Float[Array, "N K"],
    exists: Bool[Array, "N K"],
    static: Static,
    t: RingPrototypes,
) -> tuple[Int[Array, "N M"], Bool[Array, "N M"]]:
    """The regions to keep, by falling mass and uniformity; the first among equals."""
    mass, cohesion = mass.astype(t.min_mass.dtype), cohesion.astype(t.min_mass.dtype)
    total = jnp.sum(jnp.where(exists, mass, 0.0), axis=1, keepdims=True) + TINY
    large = exists & (mass / total >= t.min_mass)
    merit = mass * cohesion ** jnp.maximum(t.cohesion_power, 0.0)
    kept = min(static.switches.ring_prototypes_kept or mass.shape[1], mass.shape[1])
    order = jnp.argsort(jnp.where(large, -merit, jnp.inf), axis=1, stable=True)[:, :kept]
    return order.astype(jnp.int32), jnp.take_along_axis(large, order, axis=1)


def _take_nearest(
    points: Float[Array, "P D"],
    centers: Float[Array, "N M D"],
    inside: Bool[Array, "N M P"],
    labels: Int[Array, "N P"],
) -> Float[Array, "N M D"]:
    """The point of each region nearest to its center; among equals by cluster, then by place.

    Two points of equal weight are equally near: what differs by rounding only counts as equal.
    """
    cosine = jnp.where(inside, dot(centers, points), -jnp.inf)
    best = inside & (cosine >= jnp.max(cosine, axis=2, keepdims=True) - _ROUNDING)
    num = points.shape[0]
    rank = labels[:, None] * num + jnp.arange(num)
    at = jnp.argmin(jnp.where(best, rank, jnp.iinfo(jnp.int32).max), axis=2)
    return points[at]
