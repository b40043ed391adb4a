"""How believable is a set of objects as the content of the frame? (method.md#set-score)."""

from __future__ import annotations

import dataclasses

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from remind_jax.numerics.pytree import pytree
from remind_jax.numerics.rounding import divide, multiply
from remind_jax.remind.context.options import Menu, Options
from remind_jax.remind.thresholds.context import Sets


@pytree
class Rating:
    """What is known of sets, any leading shape.

    The later fields sum up the choices that led to a set (method.md#beam-search).
    """

    score: Float[Array, "..."]  # [0, 1]
    density: Float[Array, "..."]  # [0, 1]
    maturity: Float[Array, "..."]  # mean over the members, [0, 1)
    info: Float[Array, "..."]  # product over the classes
    support_sum: Float[Array, "..."]  # weighted by the objects to be expected
    support_weight: Float[Array, "..."]
    stability_sum: Float[Array, "..."]  # over the classes
    exclusivity_sum: Float[Array, "..."]  # over the members
    exclusive: Bool[Array, "..."]  # some choice had a lead that says something

    def pack(self) -> Float[Array, "... 9"]:
        """All fields side by side: one array to write, and to pick from."""
        return jnp.stack([leaf.astype(self.score.dtype) for leaf in jax.tree.leaves(self)], axis=-1)

    @classmethod
    def unpack(cls, packed: Float[Array, "... 9"]) -> Rating:
        """The fields of what `pack` gives."""
        *reals, exclusive = (packed[..., field] for field in range(packed.shape[-1]))
        return cls(*reals, exclusive=exclusive > 0)


@pytree
class FrameScale:
    """What every set of a frame is measured against."""

    num_detections: Int[Array, ""]  # all, those of unknown classes included
    num_classes: Int[Array, ""]  # classes that choices have been made for, at least 1
    by_size: Float[Array, "4 S"]  # terms of sets of 0, 1, 2, ... members, of `rate_sizes`


def tally_choices(rating: Rating, options: Options, menu: Menu) -> Rating:
    """Sums of sets after every choice `[W, K+1, 2]`; the rest is yet to rate."""
    row = lambda leaf: leaf[:, None, None]  # noqa: E731
    count = jnp.arange(menu.info.shape[0])
    some = (count > 0)[:, None]
    lead = multiply(count.astype(menu.info.dtype), options.exclusivity)
    support = jnp.clip(options.support, 0.0, 1.0)
    grown = dataclasses.replace(
        jax.tree.map(row, rating),
        info=row(rating.info) * menu.info[:, None],
        support_sum=row(rating.support_sum) + multiply(row(options.target), support),
        support_weight=row(rating.support_weight + options.target),
        stability_sum=row(rating.stability_sum) + jnp.where(some, row(options.stability), 0.0),
        exclusivity_sum=row(rating.exclusivity_sum) + lead[..., None],
        exclusive=row(rating.exclusive) | options.exclusive[..., None],
    )
    return jax.tree.map(lambda leaf: jnp.broadcast_to(leaf, support.shape), grown)


def rate_sizes(most: int, num_detections: Int[Array, ""], t: Sets) -> Float[Array, "4 S"]:
    """What depends on the size of a set alone, for sets of 0 to `most` members.

    Rows: coverage, the term of the size, and the factors of the weights of information and of
    exclusivity. There are far fewer sizes than sets, and powers take long.
    """
    size = jnp.arange(most + 1, dtype=jnp.int32)
    count = size.astype(t.size_scale.dtype)
    once = jnp.maximum(count, 1.0)
    excess = jnp.maximum(count - t.size_free.astype(count.dtype), 0.0)
    return jnp.stack(
        [
            rate_coverage(size, num_detections, t),
            1.0 - jnp.exp(divide(-excess, t.size_scale)),
            _decline(once, "info", t),
            _decline(once, "exclusivity", t),
        ]
    )


def score_sets(
    size: Int[Array, "..."], rating: Rating, scale: FrameScale, t: Sets
) -> Float[Array, "..."]:
    """Weighted mean of the terms, in [0, 1]; to be scaled by connection and reliability."""
    once = jnp.maximum(size.astype(rating.info.dtype), 1.0)
    classes = jnp.maximum(scale.num_classes, 1).astype(once.dtype)
    known = jnp.minimum(size, scale.by_size.shape[1] - 1)  # larger sets do not come about
    coverage, size_term, of_info, of_exclusivity = scale.by_size[:, known]
    rated = rating.exclusive & t.exclusivity & (size >= t.exclusivity_min_size)
    rated = rated & (rating.maturity >= t.exclusivity_min_maturity)
    terms = (  # summed in this order, as in the original
        (t.coverage_weight, coverage, True),
        (t.size_weight, size_term, True),
        (t.info_weight * of_info, rating.info, True),
        (t.density_weight, rating.density, size >= 2),
        (t.support_weight, rating.support_sum / jnp.maximum(rating.support_weight, 1.0), True),
        (t.stability_weight, divide(rating.stability_sum, classes), True),
        (t.exclusivity_weight * of_exclusivity, rating.exclusivity_sum / once, rated),
    )
    total, weights = jnp.zeros_like(rating.info), jnp.zeros_like(rating.info)
    for weight, value, present in terms:
        weight = jnp.where(present, jnp.maximum(weight, 0.0), 0.0)
        total = total + multiply(weight, jnp.clip(value, 0.0, 1.0))
        weights = weights + weight
    counts = weights > 1e-12
    mean = jnp.where(counts, total / jnp.where(counts, weights, 1.0), 0.0)
    return jnp.clip(mean, 0.0, 1.0)


def rate_coverage(
    size: Int[Array, "..."], num_detections: Int[Array, ""], t: Sets
) -> Float[Array, "..."]:
    """Share of the detections that a set explains; more counts for more, [0, 1]."""
    scalar = t.coverage_gain.dtype
    explained, number = size.astype(scalar), num_detections.astype(scalar)
    share = jnp.clip(divide(explained, jnp.maximum(number, 1.0)), 0.0, 1.0) ** t.coverage_power
    gain = 1.0 - jnp.exp(-(number - 1.0) / t.coverage_gain_scale)
    share = share * jnp.where(
        number > 1.0, 1.0 + multiply(jnp.maximum(t.coverage_gain, 0.0), gain), 1.0
    )
    damped = t.explained_scale > 1e-12
    damping = 1.0 - jnp.exp(divide(-explained, jnp.where(damped, t.explained_scale, 1.0)))
    return jnp.clip(share * jnp.where(damped, damping, 1.0), 0.0, 1.0)


def _decline(count: Float[Array, "..."], term: str, t: Sets) -> Float[Array, "..."]:
    """Factor of a weight that declines with the size of the set (method.md#set-score)."""
    reference, power, low, high = (
        getattr(t, f"{term}_{part}") for part in ("reference", "power", "weight_min", "weight_max")
    )
    low = jnp.maximum(low, 0.0)
    factor = (jnp.maximum(reference, 1e-6) / count) ** jnp.maximum(power, 0.0)
    return jnp.clip(factor, low, jnp.maximum(low, high))
