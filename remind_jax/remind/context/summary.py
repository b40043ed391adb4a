"""What hypotheses say of classes (method.md#hypothesis-summary, method.md#class-summary).

A class summary is kept per object: every object carries the values of its class, so that classes
need no numbering. Letters: `O` objects, `H` hypotheses.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from remind_jax.numerics.pytree import pytree
from remind_jax.numerics.ranks import largest, rank_two
from remind_jax.numerics.reductions import reduce_together
from remind_jax.numerics.rounding import divide
from remind_jax.remind.context.evidence import FrameView
from remind_jax.remind.context.hypotheses import Hypotheses
from remind_jax.remind.thresholds.context import Influence, Sets
from remind_jax.static import Static

_TINY = 1e-12


@pytree
class Context:
    """How the context sees each object, how decided its class is, and the frame as a whole."""

    kernel: Float[Array, "O"]  # mean conditional probability, given the kernel of the class
    hits: Int[Array, "O"]  # members of the kernel that speak for the object
    hit_share: Float[Array, "O"]  # [0, 1]
    covered: Bool[Array, "O"]  # enough of the kernel speaks for it
    kernel_relative: Float[Array, "O"]  # against the best of the class, [0, 1]
    hypothesis_relative: Float[Array, "O"]  # [0, 1]
    soft_supported: Bool[Array, "O"]
    shortlist: Bool[Array, "O"]  # member of a hypothesis close to the best
    kept_count: Int[Array, "O"]  # supported objects of the class
    pruning: Float[Array, "O"]  # share of the class that is not supported, [0, 1]
    strength: Float[Array, "O"]  # [0, 1]
    selectivity: Float[Array, "O"]  # lead of the best object, [0, 1]
    best_kernel: Float[Array, "O"]  # largest absolute support by the kernel
    best_relative: Float[Array, "O"]  # largest relative support of a covered object
    soft_cut: Float[Array, "O"]  # mixed support from which objects are softly supported
    quality: Float[Array, ""]  # [0, 1]
    global_ok: Bool[Array, ""]  # good enough to reward and to punish


def summarize(
    hypotheses: Hypotheses,
    view: FrameView,
    static: Static,
    sets: Sets,
    t: Influence,
) -> Context:
    """Reduces hypotheses, the best first, and kernels to one standing per object, and rates all."""
    exists, of_class = view.exists, view.object_class
    same = (of_class[:, None] == of_class[None]) & exists[:, None] & exists[None]
    kernels = find_kernels(hypotheses, same, view.anchors, static)
    link = view.conditional.T
    counted = kernels & (link >= sets.min_link)
    hits, links, num_kernel = reduce_together(
        ("sum", counted), ("sum", jnp.where(counted, link, 0.0)), ("sum", kernels), axis=1
    )
    scalar = link.dtype
    count = hits.astype(scalar)
    kernel = links / jnp.maximum(count, 1.0)
    share = count / jnp.maximum(num_kernel, 1).astype(scalar)
    covered = exists & (hits >= t.min_hits) & (share >= t.min_hit_share)

    place = jnp.arange(hypotheses.score.shape[0])
    heeded = (place < sets.prior_sets) | (sets.prior_sets <= 0)
    score = jnp.where(hypotheses.members & heeded[:, None], hypotheses.score[:, None], 0.0)
    prior, support_sum = reduce_together(("max", score), ("sum", score), axis=0)
    close = hypotheses.valid & (hypotheses.score >= hypotheses.score[0] * (1 - sets.shortlist_loss))
    strength = _mix(kernel, prior, t.strength_kernel_weight, t.strength_prior_weight, clip=False)
    best_kernel, best_prior, best_sum, best_strength = _class_max(
        jnp.stack([kernel, prior, support_sum, strength]), same
    )
    kernel_relative = _relative(kernel, best_kernel) ** t.kernel_power
    hypothesis_relative = _mix(
        _relative(prior, best_prior) ** t.hypothesis_power,
        _relative(support_sum, best_sum) ** t.hypothesis_power,
        t.top_weight,
        t.sum_weight,
    )
    mixed = _mix(
        kernel_relative, hypothesis_relative, t.soft_kernel_weight, t.soft_hypothesis_weight
    )
    mixed = jnp.where(covered, mixed, 0.0)
    soft_cut = t.soft_band * _class_max(mixed, same)
    ranked = covered & (kernel_relative > 0.0)
    among = jnp.broadcast_to(jnp.where(ranked, kernel_relative, 0.0), same.shape)
    _, best_relative, second, _ = rank_two(among, same)
    supported = ranked & (kernel_relative >= t.band * best_relative)

    kept, size = jnp.sum(same & jnp.stack([supported, exists])[:, None], axis=2, dtype=jnp.int32)
    size = jnp.maximum(size, 1).astype(scalar)
    lead = (best_relative - second) / jnp.maximum(_TINY, best_relative)
    pruning = jnp.where(exists, jnp.clip(1.0 - divide(kept.astype(scalar), size), 0.0, 1.0), 0.0)
    quality = _rate_quality(hypotheses, kept, pruning, same, exists, t)
    best = jax.tree.map(lambda leaf: leaf[0], hypotheses)
    global_ok = best.valid & (best.size >= t.min_size) & (best.score >= t.min_best_score)
    global_ok = global_ok & (best.coverage >= t.min_coverage) & (quality >= t.min_quality)
    return Context(
        kernel=kernel,
        hits=hits,
        hit_share=share,
        covered=covered,
        kernel_relative=kernel_relative,
        hypothesis_relative=hypothesis_relative,
        soft_supported=covered & (mixed > 0.0) & (mixed >= soft_cut),
        shortlist=jnp.any(hypotheses.members & close[:, None], axis=0) & exists,
        kept_count=kept,
        pruning=pruning,
        strength=jnp.clip(best_strength, 0.0, 1.0),
        selectivity=jnp.where(best_relative > 0.0, jnp.clip(lead, 0.0, 1.0), 0.0),
        best_kernel=best_kernel,
        best_relative=best_relative,
        soft_cut=soft_cut,
        quality=quality,
        global_ok=global_ok,
    )


def find_kernels(
    hypotheses: Hypotheses,
    same: Bool[Array, "O O"],
    anchors: Bool[Array, "O"],
    static: Static,
) -> Bool[Array, "O O"]:
    """Objects that speak for the class of each row object (method.md#class-summary).

    All anchors, then members of the best hypotheses that are of another class, until the kernel
    is full. At least one member enters, however many anchors there are.
    """
    slots = anchors.shape[0]
    source = hypotheses.members[: max(1, static.switches.context_hypotheses)]
    is_member, namer = largest(source, axis=0)
    named = is_member & ~anchors
    # Members in order of the first hypothesis that names them, then of their slot.
    order = jnp.lexsort((jnp.arange(slots), namer, ~named))
    foreign = (named & ~same)[:, order]
    before = jnp.cumsum(foreign, axis=1, dtype=jnp.int32) - foreign
    room = (static.switches.set_kernel or slots) - jnp.sum(anchors, dtype=jnp.int32)
    enters = foreign & ((before == 0) | (before < room))
    back = jnp.argsort(order)
    exists = same.reshape(-1)[:: slots + 1]  # in steps: the diagonal without a look-up
    return (enters[:, back] | anchors[None]) & exists[:, None]


def _rate_quality(
    hypotheses: Hypotheses,
    kept_count: Int[Array, "O"],
    pruning: Float[Array, "O"],
    same: Bool[Array, "O O"],
    exists: Bool[Array, "O"],
    t: Influence,
) -> Float[Array, ""]:
    """How far the context can be trusted, [0, 1] (method.md#context-quality)."""
    slot = jnp.arange(exists.shape[0])
    first = exists & ~jnp.any(same & (slot[None] < slot[:, None]), axis=1)
    decided = first & (kept_count > 0)
    num_decided = jnp.maximum(jnp.sum(decided, dtype=jnp.int32), 1).astype(pruning.dtype)
    pruning = jnp.sum(jnp.where(decided, pruning, 0.0)) / num_decided
    best = jax.tree.map(lambda leaf: leaf[0], hypotheses)
    extra = jnp.maximum(0, best.size - 1).astype(pruning.dtype)
    terms = (
        (t.best_weight, best.score),
        (t.coverage_weight, best.coverage),
        (t.maturity_weight, best.maturity),
        (t.density_weight, best.density),
        (t.size_weight, 1.0 - jnp.exp(-extra / t.size_scale)),
        (t.pruning_weight, pruning),
    )
    total, weights = jnp.zeros_like(pruning), jnp.zeros_like(pruning)
    for weight, value in terms:
        total = total + jnp.maximum(weight, 0.0) * jnp.clip(value, 0.0, 1.0)
        weights = weights + jnp.maximum(weight, 0.0)
    some = weights > _TINY
    return jnp.where(some, jnp.clip(total / jnp.where(some, weights, 1.0), 0.0, 1.0), 0.0)


def _class_max(value: Float[Array, "*B O"], same: Bool[Array, "O O"]) -> Float[Array, "*B O"]:
    """Largest value, not below 0, within the class of each object."""
    return jnp.max(jnp.where(same, value[..., None, :], 0.0), axis=-1)


def _relative(value: Float[Array, "O"], best: Float[Array, "O"]) -> Float[Array, "O"]:
    """Value against the best, 0 if there is none."""
    some = best > _TINY
    return jnp.where(some, jnp.clip(value / jnp.where(some, best, 1.0), 0.0, 1.0), 0.0)


def _mix(
    first: Float[Array, "O"],
    second: Float[Array, "O"],
    first_weight: Float[Array, ""],
    second_weight: Float[Array, ""],
    clip: bool = True,
) -> Float[Array, "O"]:
    """Weighted mean of two values; weights without a sum count as they are."""
    total = first_weight + second_weight
    weighted = first_weight * first + second_weight * second
    mean = divide(weighted, jnp.where(total > _TINY, total, 1.0))
    return jnp.clip(mean, 0.0, 1.0) if clip else mean
