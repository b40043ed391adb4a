"""Which objects of one class may be in view? (method.md#kernel-support, method.md#class-options).

A hypothesis takes `k` detections of the class and explains them by `k` of its objects: by the best
supported ones, or with the last of them replaced by the next. Likewise it takes the surest `k`
detections, or replaces the last. Letters: `W` sets of the beam, `K` most detections per class,
`C = K + 1` counts, `L` objects per class and one empty place.
"""

from __future__ import annotations

import math

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from remind_jax.numerics.absent import NO_SLOT
from remind_jax.numerics.pytree import pytree
from remind_jax.numerics.rounding import divide, sum_in_order
from remind_jax.remind.context.evidence import FrameView
from remind_jax.remind.thresholds.context import Sets
from remind_jax.static import Static

VARIANTS = 2  # the best choice and the one with its last element replaced
_SLACK = 1e-12
_DISTINCT = 1e-15


@pytree
class Menu:
    """The choices that a class offers to every set; `k` counts from 0 to `K`."""

    num_detections: Int[Array, ""]
    largest: Int[Array, ""]  # most objects that can be chosen
    allowed: Bool[Array, "C 2 2"]  # by detection variant and object variant
    info: Float[Array, "C"]  # (0, 1], low where many choices of k exist


@pytree
class Options:
    """The choices of one class as the sets of the beam see them."""

    ranked: Int[Array, "W C"]  # objects of the class, best supported first, NO_SLOT behind them
    support: Float[Array, "W C 2"]  # of the choice of k objects, by object variant
    target: Float[Array, "W"]  # objects of the class that one should expect
    stability: Float[Array, "W"]  # [0, 1], how unevenly the class is supported
    exclusivity: Float[Array, "W C"]  # [0, 1], lead of the best choice of k objects
    exclusive: Bool[Array, "W C"]  # whether that lead says anything


def write_menu(
    pool_size: Int[Array, ""], num_detections: Int[Array, ""], most: int, static: Static, t: Sets
) -> Menu:
    """The choices of one class; nothing at all is one, unless every class must be explained."""
    count = jnp.arange(most + 1)
    largest = jnp.minimum(num_detections, pool_size)
    fits = (count <= largest) & ((count > 0) | t.partial)
    considered = jnp.minimum(pool_size, jnp.maximum(count, static.switches.option_objects))
    replaceable = (count > 0) & jnp.stack([num_detections > count, considered > count])
    either = jnp.stack([jnp.ones_like(replaceable), replaceable], axis=-1)
    return Menu(
        num_detections=num_detections,
        largest=largest,
        allowed=fits[:, None, None] & either[0][:, :, None] & either[1][:, None, :],
        info=_information(pool_size, most, static, t),
    )


def support_by_kernel(
    members: Bool[Array, "W O"],
    pool: Int[Array, "L"],
    view: FrameView,
    maturity: Float[Array, "O"],
    static: Static,
    t: Sets,
) -> tuple[Float[Array, "W L"], Bool[Array, "W"]]:
    """Mean conditional probability of objects, given the kernel (method.md#kernel-support).

    The kernel is the anchors and, while there is room, the members of the set. Members of the
    kernel that do not speak for an object are left out of its mean.

    Returns:
      The support, the maturity of the object if there is no kernel; and which sets have a kernel.
    """
    slots = view.anchors.shape[0]
    slot = jnp.arange(slots)
    # float32 holds these keys exactly and has a fast top_k.
    key = jnp.where(view.anchors, slot, jnp.where(members, slots + slot, 2 * slots))
    key = key.astype(jnp.float32)
    found, kernel = jax.lax.top_k(-key, min(static.switches.set_kernel or slots, slots))
    in_kernel = -found < 2 * slots
    at = jnp.maximum(pool, 0)
    link = view.conditional[:, at][kernel]
    counted = (link >= t.min_link) & in_kernel[:, :, None]
    count = jnp.sum(counted, axis=1, dtype=jnp.int32)
    total = sum_in_order(jnp.moveaxis(link, 1, 0), jnp.moveaxis(counted, 1, 0))
    support = divide(total, jnp.maximum(count, 1).astype(total.dtype))
    has_kernel = jnp.any(in_kernel, axis=1)
    return jnp.where(has_kernel[:, None], support, maturity[at][None]), has_kernel


def list_options(
    support: Float[Array, "W L"],
    has_kernel: Bool[Array, "W"],
    pool: Int[Array, "L"],
    menu: Menu,
    t: Sets,
) -> Options:
    """Ranks the objects of a class and rates every choice among them (method.md#class-options).

    Support comes from other objects for sets that have a kernel. The pool lists the latest first.
    """
    most = menu.info.shape[0] - 1
    scalar = support.dtype
    included = pool != NO_SLOT
    # The pool lists late objects first, so that a stable order breaks ties toward them.
    best, at = jax.lax.top_k(jnp.where(included, support, -jnp.inf), most + 1)
    ranked = jnp.where(best >= 0.0, pool[at], NO_SLOT)
    value = jnp.maximum(best, 0.0)

    plausible = included & (support + _SLACK >= t.plausible_share * value[:, :1])
    target = jnp.sum(plausible, axis=1, dtype=jnp.int32)
    target = jnp.minimum(menu.num_detections, jnp.maximum(1, target)).astype(scalar)

    up_to = jnp.asarray(np.arange(most)[:, None, None] < np.arange(most + 1))
    sums = sum_in_order(value.T[:most, :, None], up_to)
    counts = jnp.arange(1, most + 1).astype(scalar)
    chosen = jnp.stack([sums[:, 1:], sums[:, :-1] + value[:, 1:]], axis=-1)
    fill = jnp.minimum(1.0, divide(counts[None], target[:, None])) ** t.fill_power
    rated = divide(chosen, counts[:, None]) * fill[..., None]
    rated = jnp.pad(rated, ((0, 0), (1, 0), (0, 0)))

    exclusivity, exclusive = _exclusivity(rated, menu.allowed, t)
    return Options(
        ranked=ranked,
        support=rated,
        target=target,
        stability=_stability(support, included & has_kernel[:, None], t),
        exclusivity=exclusivity,
        exclusive=exclusive,
    )


def _information(
    pool_size: Int[Array, ""], most: int, static: Static, t: Sets
) -> Float[Array, "C"]:
    """1 for a forced choice, less the more choices of that size exist."""
    logs = np.array([math.lgamma(n + 1) for n in range(max(static.switches.class_pool, most) + 1)])
    log_factorial = jnp.asarray(logs, t.choice_penalty.dtype)
    count = jnp.arange(most + 1)
    rest = jnp.maximum(pool_size - count, 0)
    choices = log_factorial[pool_size] - log_factorial[count] - log_factorial[rest]
    free = (count > 0) & (count < pool_size)
    return 1.0 / (1.0 + t.choice_penalty * jnp.where(free, jnp.maximum(choices, 0.0), 0.0))


def _stability(
    support: Float[Array, "W L"], included: Bool[Array, "W L"], t: Sets
) -> Float[Array, "W"]:
    """1 if one object has all support, 0 if it is spread evenly."""
    support, included = support.T[::-1], included.T[::-1]  # early objects first
    total = sum_in_order(support, included)
    some = total > t.stability_eps
    share = jnp.where(some & included, divide(support, jnp.where(some, total, 1.0)), 0.0)
    entropy = sum_in_order(-share * jnp.log(jnp.maximum(t.stability_eps, share)), included)
    positive = jnp.sum(share > 0.0, axis=0, dtype=jnp.int32).astype(support.dtype)
    spread = jnp.clip(entropy / jnp.log(jnp.maximum(2.0, positive)), 0.0, 1.0)
    return jnp.where(some, 1.0 - spread, 0.0)


def _exclusivity(
    rated: Float[Array, "W C 2"], allowed: Bool[Array, "C 2 2"], t: Sets
) -> tuple[Float[Array, "W C"], Bool[Array, "W C"]]:
    """Relative lead of the better of both object variants, and whether there is one."""
    best, other = rated[..., 0], jnp.where(allowed[:, 0, 1], rated[..., 1], 0.0)
    second = jnp.where(other < best - _DISTINCT, other, 0.0)
    counts = (best > t.exclusivity_eps) & t.exclusivity
    lead = divide(best - second, jnp.maximum(t.exclusivity_eps, best))
    distinct = counts & ((second > 0.0) | (best - second > _SLACK))
    return jnp.where(counts, jnp.clip(lead, 0.0, 1.0), 0.0), distinct
