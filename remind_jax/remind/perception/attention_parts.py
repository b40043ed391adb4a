"""Parts of an object by what its patches attend to (method.md#attention-parts).

Letters: `N` detections, `P` patches, `Q` object patches of the frame whose attention is known,
`S` seeds, `D` dimensions.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from remind_jax.numerics.pooling import TINY, is_largest
from remind_jax.numerics.rounding import unit
from remind_jax.observation import PatchAttention
from remind_jax.remind.perception.parts import pool_regions, weigh_patches
from remind_jax.remind.thresholds.perception import AttentionParts
from remind_jax.static import Static


def find_attention_parts(
    features: Float[Array, "P D"],
    coverage: Float[Array, "N P"],
    members: Bool[Array, "N P"],
    attention: PatchAttention,
    static: Static,
    t: AttentionParts,
) -> tuple[Float[Array, "N S D"], Bool[Array, "N S"], Float[Array, "N S"]]:
    """Describes each object by regions around the patches that matter most to its others.

    Returns:
      Unit vectors by falling importance of their seeds, which of them exist, and their summed
      coverage (their number of patches, if coverage does not weigh).
    """
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
    valid = exists & present
    support = jnp.where(valid, jnp.sum(weights, axis=-1), 0.0)
    order = jnp.argsort(~valid, axis=-1, stable=True)
    vectors = jnp.where(valid[..., None], unit(mean), 0.0)
    return (
        jnp.take_along_axis(vectors, order[..., None], axis=1),
        jnp.take_along_axis(valid, order, axis=1),
        jnp.take_along_axis(support, order, axis=1),
    )


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
