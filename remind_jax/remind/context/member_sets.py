"""Sets of objects that grow one member at a time (paper III-D; method.md#member-sets).

The density of a set is the mean link of its maximum spanning tree. Instead of a tree, a set
carries the strength of the best path between any two members, where a path is as strong as its
weakest link. A new member updates all paths at once, and the tree weighs as much as the sum of the
best path from each member to an earlier one, in whatever order the members are counted. Functions
on a `MemberSet` are written for one set; callers `vmap`. Letters: `M` most members of a set, `J`
newcomers, `O` object slots, `B` sets.
"""

from __future__ import annotations

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from remind_jax.numerics.absent import NO_SLOT
from remind_jax.numerics.pytree import pytree
from remind_jax.numerics.rounding import divide, sum_in_order
from remind_jax.remind.context.evidence import Links
from remind_jax.remind.thresholds.context import Sets

_OWN = 2.0  # strength of the path to oneself, above every link
_NO_PATH = -1.0  # below every link
_FLOOR = 1e-12  # of a maturity, before powers are taken


@pytree
class MemberSet:
    """One set of objects."""

    members: Bool[Array, "O"]
    slot: Int[Array, "M"]  # members in order of entry, NO_SLOT behind them
    size: Int[Array, ""]
    path: Float[Array, "M M"]  # strength of the best path between two members, by entry


@pytree
class LinkCounts:
    """Who in a set has been seen with whom in it, any leading shape."""

    pairs: Float[Array, "..."]
    linked: Float[Array, "..."]  # members seen with at least one other
    isolated: Bool[Array, "..."]  # some member has too few links


def empty_set(num_members: int, num_objects: int, scalar: jnp.dtype) -> MemberSet:
    """The set without members."""
    return MemberSet(
        members=jnp.zeros(num_objects, bool),
        slot=jnp.full(num_members, NO_SLOT, jnp.int32),
        size=jnp.int32(0),
        path=jnp.full((num_members, num_members), _NO_PATH, scalar),
    )


def line_up(one: MemberSet, newcomers: Int[Array, "J"]) -> Int[Array, "M"]:
    """The slots of a set once all newcomers have entered in their order."""
    entry = jnp.arange(one.slot.shape[0]) - one.size
    arrives = (entry >= 0) & (entry < newcomers.shape[0])
    return jnp.where(arrives, newcomers[jnp.clip(entry, 0, newcomers.shape[0] - 1)], one.slot)


def link_strengths(
    newcomers: Int[Array, "J"], slot: Int[Array, "M"], links: Links
) -> Float[Array, "J M"]:
    """Strength of the link of each newcomer to each slot; NO_SLOT has none."""
    strength = links.strength[jnp.maximum(newcomers, 0)[:, None], jnp.maximum(slot, 0)]
    return jnp.where((newcomers != NO_SLOT)[:, None], strength, _NO_PATH)


def reach_members(path: Float[Array, "M M"], link: Float[Array, "M"]) -> Float[Array, "M"]:
    """Strength of the best path from a newcomer to each member, by its links to members."""
    # The matrix is symmetric: the reduced axis comes first, so that the last one stays whole.
    return jnp.max(jnp.minimum(link[:, None], path), axis=0)


def extend_paths(
    path: Float[Array, "M M"], reach: Float[Array, "M"], entry: Int[Array, ""]
) -> Float[Array, "M M"]:
    """Paths once a newcomer has entered at a position; NO_SLOT: it does not."""
    reach = jnp.where(jnp.arange(reach.shape[0]) == entry, _OWN, reach)
    return jnp.maximum(path, jnp.minimum(reach[:, None], reach))


def tree_edges(path: Float[Array, "M M"]) -> Float[Array, "M"]:
    """Best path from each member to an earlier one: the links of the maximum spanning tree."""
    position = jnp.arange(path.shape[0])
    earlier = position[:, None] < position
    return jnp.max(jnp.where(earlier, path, 0.0), axis=0)


def rate_cohesion(
    size: Int[Array, "*B"], tree: Float[Array, "*B"], counts: LinkCounts, t: Sets
) -> tuple[Float[Array, "*B"], Float[Array, "*B"]]:
    """Density and connection of sets from their trees and links (method.md#member-sets).

    Both in [0, 1]; the density is 0 below two members, the connection a factor of the score.
    """
    number, several = size.astype(tree.dtype), size >= 2
    pair_share = counts.pairs / jnp.maximum(number * (number - 1.0) / 2.0, 1.0)
    linked_share = counts.linked / jnp.maximum(number, 1.0)
    gated = t.min_link > 0.0
    density = tree / jnp.maximum(number - 1.0, 1.0)
    density = density * jnp.where(gated, _power(pair_share, t.density_power), 1.0)
    connection = _power(linked_share, t.linked_power) * _power(pair_share, t.pairs_power)
    connection = jnp.where(counts.isolated, 0.0, connection)
    density = jnp.where(several, jnp.clip(density, 0.0, 1.0), 0.0)
    return density, jnp.where(several & gated, connection, 1.0)


def rate_trust(
    members: Bool[Array, "O *B"], size: Int[Array, "*B"], maturity: Float[Array, "O"], t: Sets
) -> tuple[Float[Array, "*B"], Float[Array, "*B"]]:
    """Mean maturity of sets and how reliable their members are (method.md#member-sets).

    Reliability is a power of a power mean that leans toward the least mature member, [0, 1]; it is
    a factor of the score.
    """
    floored = jnp.maximum(_FLOOR, maturity)
    geometric = jnp.abs(t.maturity_mean) <= _FLOOR
    exponent = jnp.where(geometric, 1.0, t.maturity_mean)
    power = jnp.where(geometric, jnp.log(floored), floored**exponent)
    both = jnp.stack([maturity, power], axis=1).reshape(-1, 2, *[1] * size.ndim)
    total = sum_in_order(both, members[:, None])
    mean, mean_power = divide(total, jnp.maximum(size, 1).astype(maturity.dtype))
    coherence = jnp.maximum(0.0, mean_power) ** (1.0 / exponent)
    coherence = jnp.where(geometric, jnp.exp(mean_power), coherence)
    coherence = jnp.where(size == 1, mean, jnp.clip(coherence, 0.0, 1.0))
    coherence = jnp.where(size > 0, coherence, 0.0)
    return mean, jnp.where(t.maturity, _power(coherence, t.maturity_power), 1.0)


def _power(share: Float[Array, "*B"], exponent: Float[Array, ""]) -> Float[Array, "*B"]:
    """`share` in [0, 1] to a power; powers that are not positive leave it out."""
    return jnp.where(exponent > 0.0, jnp.clip(share, 0.0, 1.0) ** exponent, 1.0)
