"""Parts of a detection (method.md#k-means-parts, method.md#attention-parts).

Letters: `N` detections, `P` patches, `K` clusters, `D` dimensions.
"""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, Shaped

from remind_jax.numerics.pooling import TINY, dot, is_largest, keep_typical, pool
from remind_jax.numerics.pytree import choose
from remind_jax.numerics.ranks import rank_rising
from remind_jax.numerics.reductions import reduce_together
from remind_jax.numerics.rounding import unit
from remind_jax.observation import PatchAttention
from remind_jax.remind.thresholds.perception import AttentionParts, Perception
from remind_jax.solvers.clustering import kmeans
from remind_jax.static import Static


class Parts(NamedTuple):
    """Parts of every detection, those that exist first."""

    vector: Float[Array, "N K D"]  # unit
    exists: Bool[Array, "N K"]
    support: Float[Array, "N K"]  # summed coverage; number of patches if coverage does not weigh


def cluster_parts(
    features: Float[Array, "P D"],
    coverage: Float[Array, "N P"],
    members: Bool[Array, "N P"],
    static: Static,
    t: Perception,
) -> Parts:
    """Up to K parts of differing appearance, by falling support, or by cluster if alike ones stay.

    Patches are clustered by direction, parts are pooled from the raw features. What happens to a
    part that resembles a better supported one is up to `static.part_resembling`.
    """
    s = static.switches
    norm = jnp.sqrt(jnp.sum(features * features, axis=-1, keepdims=True)) + TINY
    labels, _ = kmeans(
        features / norm,
        members & t.parts_enabled,
        clusters=s.part_clusters,
        iterations=s.part_iterations,
        restarts=s.part_restarts,
        seed=s.part_seed,
        solver=static.solver,
    )
    inside = labels[:, None, :] == jnp.arange(s.part_clusters)[:, None]
    weights = weigh_patches(inside, coverage, s.part_weighted)
    support = jnp.sum(weights, axis=-1)
    mean, present = pool_regions(
        features, weights, inside, s.part_mean, t.part_trim_keep, t.part_trim_min_patches
    )

    size = jnp.sum(inside, axis=-1)
    # An object that is one cluster is one part by itself and is spared the test of size.
    count = jnp.sum(members, axis=-1, keepdims=True)
    alone = jnp.minimum(count, s.part_clusters) == 1
    large = (size >= t.part_min_patches) & (support >= t.part_min_support)
    valid = present & (large | (alone & (size > 0)))
    parts = Parts(unit(mean), valid, support)
    if s.part_resembling == "keep":
        return _compact(parts)
    return _merge_resembling(parts, t.part_merge, joins=s.part_resembling == "join")


def weigh_patches(
    inside: Bool[Array, "N K P"], coverage: Float[Array, "N P"], weighted: bool
) -> Float[Array, "N K P"]:
    """Weight of every patch in every region: its coverage, or 1; 0 outside."""
    share = coverage[:, None] if weighted else jnp.ones((), coverage.dtype)
    return jnp.where(inside, share, 0.0)


def pool_regions(
    features: Float[Array, "P D"],
    weights: Float[Array, "N K P"],
    inside: Bool[Array, "N K P"],
    mean: str,
    trim_keep: Float[Array, ""],
    trim_min_patches: Int[Array, ""],
) -> tuple[Float[Array, "N K D"], Bool[Array, "N K"]]:
    """Mean feature of every region, of its typical patches only if `mean` is `"trimmed"`."""
    means, present = pool(weights, features)
    if mean == "plain":
        return means, present
    flat = means.reshape(-1, means.shape[-1]), inside.reshape(-1, inside.shape[2])
    typical = keep_typical(features, *flat, trim_keep, trim_min_patches).reshape(inside.shape)
    trimmed, left = pool(jnp.where(typical, weights, 0.0), features)
    return trimmed, present & left


def _merge_resembling(given: Parts, merge: Float[Array, ""], joins: bool) -> Parts:
    """Visits parts by falling support; one that resembles a kept part is dropped or joins it."""
    parts, valid, support = _sort(jnp.where(given.exists, -given.support, jnp.inf), given)
    ranks = jnp.arange(valid.shape[1])
    similarity = dot(parts, parts)

    def visit(rank: Int[Array, ""], state: tuple[Array, Array, Array]):
        kept, parts, support = state
        new = jax.lax.dynamic_index_in_dim(parts, rank, axis=1)
        cosine = dot(parts, new)[..., 0] if joins else similarity[:, rank]
        cosine = jnp.where(kept & (ranks < rank), cosine, -jnp.inf)
        alike = jnp.max(cosine, axis=-1).astype(merge.dtype) > merge
        exists = valid[:, rank]
        kept = kept | ((ranks == rank) & (exists & ~alike)[:, None])
        if not joins:
            return kept, parts, support
        into = (ranks == jnp.argmax(cosine, axis=-1)[:, None]) & (alike & exists)[:, None]
        added = support[:, rank, None]
        total = support + added
        both = parts * support[..., None] + new * added[..., None]
        both = unit(both / jnp.where(total > TINY, total, 1.0)[..., None])
        return kept, *choose(into & (total > TINY), (both, total), (parts, support))

    kept = jnp.zeros_like(valid)
    kept, parts, support = jax.lax.fori_loop(0, valid.shape[1], visit, (kept, parts, support))
    return _compact(Parts(parts, kept, support))


def _compact(parts: Parts) -> Parts:
    """The parts that exist first, in their order."""
    vector, exists, support = parts
    vector, support = jnp.where(exists[..., None], vector, 0.0), jnp.where(exists, support, 0.0)
    return _sort(~exists, Parts(vector, exists, support))


def _sort(key: Shaped[Array, "N K"], parts: Parts) -> Parts:
    """The parts of each object by a rising key, equal ones in their order."""
    place = jnp.arange(key.shape[1])
    is_at = rank_rising([key])[:, None] == place[:, None]
    exists, support, at = reduce_together(
        ("any", is_at & parts.exists[:, None]),
        ("sum", jnp.where(is_at, parts.support[:, None], 0.0)),
        ("sum", jnp.where(is_at, place, 0)),
        axis=2,
    )
    return Parts(jnp.take_along_axis(parts.vector, at[..., None], axis=1), exists, support)


def find_attention_parts(
    features: Float[Array, "P D"],
    coverage: Float[Array, "N P"],
    members: Bool[Array, "N P"],
    attention: PatchAttention,
    static: Static,
    t: AttentionParts,
) -> Parts:
    """Regions around the patches that matter most to the object's others, these first."""
    known = attention.patches >= 0
    at = jnp.maximum(attention.patches, 0)
    mine = members[:, at] & known
    paid = attention.block / (attention.row_sums + TINY)[:, None]
    seeds, exists = _choose_seeds(paid, mine, static)
    region = _surround(paid, mine, seeds, t)
    inside = jnp.zeros((*region.shape[:2], members.shape[1]), bool)
    inside = inside.at[:, :, jnp.where(known, at, members.shape[1])].max(region, mode="drop")
    inside = inside & exists[..., None]

    weights = weigh_patches(inside, coverage, static.switches.attention_weighted)
    mean, present = pool_regions(
        features, weights, inside, static.switches.attention_mean, t.trim_keep, t.trim_min_patches
    )
    return _compact(Parts(unit(mean), exists & present, jnp.sum(weights, axis=-1)))


def _choose_seeds(
    paid: Float[Array, "Q Q"], mine: Bool[Array, "N Q"], static: Static
) -> tuple[Int[Array, "N S"], Bool[Array, "N S"]]:
    """The patches that the object's patches attend to most, or that attend to them most."""
    share = paid if static.switches.attention_seed == "attended" else paid.T
    score = jnp.einsum("nq,qr->nr", mine.astype(paid.dtype), share, precision="highest")
    score = jnp.where(mine, score, -jnp.inf)
    num = min(static.switches.attention_seeds, paid.shape[0])
    best, seeds = jax.lax.top_k(score, num)
    missing = ((0, 0), (0, static.switches.attention_seeds - num))
    return jnp.pad(seeds, missing), jnp.pad(best > -jnp.inf, missing)


def _surround(
    paid: Float[Array, "Q Q"],
    mine: Bool[Array, "N Q"],
    seeds: Int[Array, "N S"],
    t: AttentionParts,
) -> Bool[Array, "N S Q"]:
    """The patches of the object that each seed attends to most, itself last."""
    count = jnp.sum(mine, axis=1).astype(t.region_share.dtype)
    most = jnp.ceil(t.region_limit * count)
    most = jnp.where(most < 1, count, most)
    wanted = jnp.maximum(t.region_min_patches, jnp.ceil(t.region_share * count))
    wanted = jnp.minimum(jnp.minimum(wanted, most), count).astype(jnp.int32)

    shape, num = (*seeds.shape, paid.shape[0]), seeds.size
    itself = jnp.arange(paid.shape[0]) == seeds[..., None]
    strength = jnp.where(itself, 0.0, paid[seeds])
    region = is_largest(
        strength.reshape(num, -1),
        jnp.broadcast_to(mine[:, None], shape).reshape(num, -1),
        jnp.repeat(wanted, seeds.shape[1]),
    )
    return region.reshape(shape)
