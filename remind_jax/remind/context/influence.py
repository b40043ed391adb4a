"""What the context adds to or takes from a candidate (method.md#cooccurrence-bonus)."""

from __future__ import annotations

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from remind_jax.numerics.pytree import pytree
from remind_jax.numerics.rounding import divide
from remind_jax.remind.context.summary import Context
from remind_jax.remind.thresholds import Thresholds
from remind_jax.remind.thresholds.context import Influence as Rules

_TINY = 1e-12
_SLACK = 1e-9


@pytree
class Influence:
    """Context per object, whatever detection it is a candidate of (method.md#cooccurrence-bonus).

    Without a usable context all values from `bonus_raw` to `kernel_raw` are zero; without any
    context everything is.
    """

    bonus_raw: Float[Array, "O"]  # change of score, within the two caps
    score_sets: Float[Array, "O"]  # support less contradiction, [-1, 1]
    support: Float[Array, "O"]  # [0, 1]
    compat_rel: Float[Array, "O"]  # support by the kernel against the best of the class, [0, 1]
    compat_band: Bool[Array, "O"]  # among the objects of its class that fit the context
    kernel_raw: Float[Array, "O"]  # absolute support by the kernel, [0, 1]
    soft_supported: Bool[Array, "O"]  # protected from vetoes
    shortlist: Bool[Array, "O"]  # protected from vetoes
    kept_count: Int[Array, "O"]  # supported objects of its class
    pruning: Float[Array, "O"]  # share of its class that is not supported, [0, 1]
    strength: Float[Array, "O"]  # how strongly its class is supported, [0, 1]
    has_pack: Bool[Array, "O"]  # its class has a summary
    quality: Float[Array, ""]  # of the context, [0, 1]
    global_ok: Bool[Array, ""]  # the context is good enough to reward and to punish
    enabled: Bool[Array, ""]  # there is a context


def no_influence(num_objects: int, scalar: jnp.dtype) -> Influence:
    """The values without a context."""
    real, no = jnp.zeros(num_objects, scalar), jnp.zeros(num_objects, bool)
    return Influence(
        bonus_raw=real,
        score_sets=real,
        support=real,
        compat_rel=real,
        compat_band=no,
        kernel_raw=real,
        soft_supported=no,
        shortlist=no,
        kept_count=jnp.zeros(num_objects, jnp.int32),
        pruning=real,
        strength=real,
        has_pack=no,
        quality=jnp.zeros((), scalar),
        global_ok=jnp.zeros((), bool),
        enabled=jnp.zeros((), bool),
    )


def weigh_influence(context: Context, exists: Bool[Array, "O"], t: Rules) -> Influence:
    """Support, contradiction and the bonus or penalty that follow for each object."""
    usable = context.global_ok & (context.quality >= t.min_quality) & exists
    ready = (context.kernel >= t.min_kernel) & context.covered
    in_band = (context.best_relative > 0.0) & (context.kernel_relative > 0.0)
    in_band = in_band & (context.kernel_relative >= jnp.maximum(0.0, context.soft_cut - _SLACK))
    inside = ready & (in_band | context.soft_supported)

    weights = jnp.maximum(_TINY, t.local_weight + t.global_weight)
    support = t.local_weight * _local_support(context, t)
    support = support + t.global_weight * _global_support(context, inside, t)
    support = jnp.clip(divide(support, weights), 0.0, 1.0)
    contradicted = (
        ~inside & (context.kept_count > 0) & (context.pruning >= t.contradiction_min_pruning)
    )
    contradicted = contradicted & (context.strength >= t.contradiction_min_strength)
    contradicted = contradicted & (context.kernel_relative <= t.contradiction_max_support)
    contradiction = jnp.where(contradicted, context.pruning, 0.0)
    quality = context.quality
    bonus = t.positive_cap * quality * support - t.negative_cap * quality * contradiction
    used = lambda value: jnp.where(usable, value, 0.0)  # noqa: E731
    return Influence(
        bonus_raw=used(bonus),
        score_sets=used(support - contradiction),
        support=used(support),
        compat_rel=used(context.kernel_relative),
        compat_band=usable & inside,
        kernel_raw=used(context.kernel),
        soft_supported=context.soft_supported,
        shortlist=context.shortlist,
        kept_count=context.kept_count,
        pruning=context.pruning,
        strength=context.strength,
        has_pack=exists,
        quality=quality,
        global_ok=context.global_ok,
        enabled=jnp.ones((), bool),
    )


def find_supported(influence: Influence, t: Thresholds) -> Bool[Array, "O"]:
    """Objects that the context clearly backs (method.md#context-support)."""
    some = (influence.support > _TINY) | (influence.score_sets > _TINY)
    strong = (influence.compat_rel >= t.ambiguous.min_relative_support) & (
        influence.kernel_raw >= t.influence.min_kernel
    )
    net = influence.score_sets >= t.ambiguous.min_net_support
    return (some & (influence.compat_band | strong)) | net


def _local_support(context: Context, t: Rules) -> Float[Array, "O"]:
    """Support by the surroundings alone, [0, 1]."""
    counts = context.covered & (context.kernel >= t.local_min_kernel)
    counts = (
        counts & (context.hits >= t.local_min_hits) & (context.hit_share >= t.local_min_hit_share)
    )
    least = t.local_min_hit_share
    hits = jnp.clip(divide(context.hit_share - least, jnp.maximum(_TINY, 1.0 - least)), 0.0, 1.0)
    enough = jnp.maximum(1, t.local_min_hits).astype(hits.dtype)
    count = jnp.clip(divide(context.hits.astype(hits.dtype), enough), 0.0, 1.0)
    reference = jnp.maximum(jnp.maximum(_TINY, context.best_kernel), t.local_min_kernel)
    kernel = jnp.clip(context.kernel / reference, 0.0, 1.0)
    support = t.local_hits_weight * hits + t.local_count_weight * count
    support = support + t.local_kernel_weight * kernel
    return jnp.where(counts, jnp.clip(support, 0.0, 1.0), 0.0)


def _global_support(context: Context, inside: Bool[Array, "O"], t: Rules) -> Float[Array, "O"]:
    """Support by the rank within the class, [0, 1]."""

    def above(value: Float[Array, "O"]) -> Float[Array, "O"]:
        share = divide(value - t.neutral, jnp.maximum(_TINY, 1.0 - t.neutral))
        return jnp.clip(share, 0.0, 1.0)

    selective = t.selectivity_weight * above(context.hypothesis_relative)
    selective = selective * (0.5 + 0.5 * context.selectivity)
    support = t.pruned_weight * context.pruning + t.rank_weight * above(context.kernel_relative)
    support = support + selective
    return jnp.where(inside & (context.kept_count > 0), jnp.clip(support, 0.0, 1.0), 0.0)
