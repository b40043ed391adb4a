"""Which children of a beam live on? (method.md#beam-search).

Letters: `W` beam rows, `S` sets of the beam, `K` most detections per class, `C = K + 1` counts.
"""

from __future__ import annotations

import dataclasses

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from remind_jax.numerics.ranks import count_before
from remind_jax.remind.context.options import VARIANTS


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Children:
    """The rows of the next beam, by their parent and what they chose."""

    row: Int[Array, "W"]  # parent
    count: Int[Array, "W"]  # detections and objects chosen
    det_variant: Int[Array, "W"]  # 1: the last detection replaced by the next
    variant: Int[Array, "W"]  # 1: the last object replaced by the next
    valid: Bool[Array, "W"]


def rank_choices(
    support: Float[Array, "S C 2"], allowed: Bool[Array, "C 2 2"]
) -> Int[Array, "S choices"]:
    """The choices of every set by falling support of their objects; those that exist first."""
    support = jnp.where(allowed, support[:, :, None, :], -jnp.inf)
    return jnp.argsort(-support.reshape(support.shape[0], -1), axis=1, stable=True)


def select_children(
    score: Float[Array, "S C 2"],
    order: Int[Array, "S choices"],
    allowed: Bool[Array, "C 2 2"],
    set_of: Int[Array, "W"],
    live: Bool[Array, "W"],
    diverse: Bool[Array, ""],
) -> Children:
    """The best children, ordered by score, then row, then support of the choice.

    With `diverse`, the best child of each count comes first, the largest count at the front.

    Args:
      score: Of each set after each choice of objects.
      order: Choices of each set as `rank_choices` gives them.
      allowed: Choices that exist, by detection variant and object variant.
      set_of: Set of each row.
      live: Rows in use.
      diverse: Whether every count has its place.
    """
    counts = score.shape[1]
    choices = counts * VARIANTS * VARIANTS
    by_index = jnp.where(allowed, score[:, :, None, :], -jnp.inf)
    value = jnp.take_along_axis(by_index.reshape(-1, choices), order, axis=1)
    value = jnp.where(live[:, None], value[set_of], -jnp.inf)
    choice = order[set_of]

    # The first best row of each count, then its first best place there.
    of_count = jnp.max(by_index, axis=(2, 3))[:, ::-1]
    of_count = jnp.where(live[:, None], of_count[set_of], -jnp.inf)
    leading = jnp.argmax(of_count, axis=0)
    top = jnp.max(of_count, axis=0)
    chosen = choice[leading] // VARIANTS**2 == jnp.arange(counts - 1, -1, -1)[:, None]
    place = jnp.argmax(chosen & (value[leading] == top[:, None]), axis=1)
    leader = (leading * choices + place).astype(jnp.int32)
    leads = (top >= 0.0) & diverse
    value, choice = value.reshape(-1), choice.reshape(-1)
    index = jnp.arange(len(value), dtype=jnp.int32)
    is_leader = jnp.any(leads & (index[:, None] == leader), axis=1)
    best, rest = jax.lax.top_k(jnp.where(is_leader, -jnp.inf, value), live.shape[0])
    # Leaders in front, then the rest.
    row, before = jnp.arange(live.shape[0]), count_before(leads)
    num_leads = before[-1] + leads[-1]
    ahead = leads & (before == row[:, None])
    front = jnp.sum(jnp.where(ahead, leader, 0), axis=1, dtype=jnp.int32)
    behind = jnp.maximum(row - num_leads, 0)
    child = jnp.where(row < num_leads, front, rest[behind])
    valid = (row < num_leads) | (best[behind] >= 0.0)
    choice = choice[child].astype(jnp.int32)
    return Children(
        row=child // choices,
        count=choice // VARIANTS**2,
        det_variant=choice // VARIANTS % VARIANTS,
        variant=choice % VARIANTS,
        valid=valid,
    )


def number_sets(
    parent: Int[Array, "W"], child: Children, most: int
) -> tuple[Int[Array, "W"], Int[Array, "W"], Int[Array, ""]]:
    """Numbers the sets of the children.

    Returns:
      Set of each child, a child of each set, and the number of sets.
    """
    index = jnp.arange(parent.shape[0], dtype=jnp.int32)
    key = (parent * (most + 1) + child.count) * VARIANTS + child.variant
    same = (key[:, None] == key[None]) & child.valid[:, None] & child.valid[None]
    first = jnp.argmax(same, axis=1)
    leads = child.valid & (first == index)
    number = count_before(leads)
    num_sets = number[-1] + leads[-1]
    origin = jnp.sum(jnp.where(leads & (number == index[:, None]), index, 0), axis=1)
    return jnp.where(child.valid, number[first], 0), origin, num_sets
