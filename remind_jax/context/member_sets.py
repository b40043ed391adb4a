"""Sets of objects that grow one member at a time (paper III-D; context notes 7.6).

The density of a set is the mean link of its maximum spanning tree. Instead of a tree, a set carries
the strength of the best path between any two members, where a path is as strong as its weakest
link. A new member updates all paths at once, and the tree weighs as much as the sum of the best
path from each member to an earlier one. Letters: `M` most members of a set, `O` object slots.
"""

from __future__ import annotations

import dataclasses

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from remind_jax.config.context_thresholds import Sets
from remind_jax.context.evidence import Links
from remind_jax.context.summation import sum_in_order

NOBODY = -1  # instead of an object slot
_OWN = 2.0  # strength of the path to oneself, above every link
_NO_PATH = -1.0  # below every link
_FLOOR = 1e-12  # of a maturity, before powers are taken


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class MemberSet:
    """One set of objects with the sums that its score needs."""

    members: Bool[Array, "O"]
    slot: Int[Array, "M"]  # members in order of entry, NOBODY behind them
    size: Int[Array, ""]
    path: Float[Array, "M M"]  # strength of the best path between two members
    degree: Int[Array, "M"]  # links of each member within the set
    ordered: Int[Array, "M"]  # members by rising slot, O behind them


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Cohesion:
    """How well sets hold together, any leading shape."""

    density: Float[Array, "..."]  # [0, 1]; absent below two members
    connection: Float[Array, "..."]  # [0, 1], factor of the score
    maturity: Float[Array, "..."]  # mean over the members
    reliability: Float[Array, "..."]  # [0, 1], factor of the score


def empty_set(num_members: int, num_objects: int, scalar: jnp.dtype) -> MemberSet:
    """The set without members."""
    return MemberSet(
        members=jnp.zeros(num_objects, bool),
        slot=jnp.full(num_members, NOBODY, jnp.int32),
        size=jnp.int32(0),
        path=jnp.full((num_members, num_members), _NO_PATH, scalar),
        degree=jnp.zeros(num_members, jnp.int32),
        ordered=jnp.full(num_members, num_objects, jnp.int32),
    )


def add_member(one: MemberSet, newcomer: Int[Array, ""], links: Links) -> MemberSet:
    """Adds an object that is not a member yet; `NOBODY` changes nothing. Unbatched."""
    real = newcomer != NOBODY
    at = jnp.maximum(newcomer, 0)
    position = jnp.arange(one.slot.shape[0])
    entry = (position == one.size) & real

    # The path matrix is symmetric: the reduced axis comes first, so that the last one stays whole.
    link = jnp.where(real, links.strength[at][one.slot], _NO_PATH)
    reach = jnp.max(jnp.minimum(link[:, None], one.path), axis=0)
    reach = jnp.where(entry, _OWN, reach)
    linked = links.present[at][one.slot] & (position < one.size) & real

    rank = jnp.sum(one.ordered < at, dtype=jnp.int32)
    inserted = jnp.where(position == rank, at.astype(jnp.int32), jnp.roll(one.ordered, 1))
    return MemberSet(
        members=one.members | ((jnp.arange(one.members.shape[0]) == at) & real),
        slot=jnp.where(entry, at.astype(jnp.int32), one.slot),
        size=one.size + real,
        path=jnp.maximum(one.path, jnp.minimum(reach[:, None], reach[None])),
        degree=jnp.where(entry, jnp.sum(linked, dtype=jnp.int32), one.degree + linked),
        ordered=jnp.where(real & (position >= rank), inserted, one.ordered),
    )


def rate_cohesion(one: MemberSet, links: Links, t: Sets) -> Cohesion:
    """Density, connection and reliability of a set (notes 7.6). Unbatched."""
    scalar = one.path.dtype
    size = one.size.astype(scalar)
    several = one.size >= 2
    position = jnp.arange(one.slot.shape[0])
    member = position < one.size
    earlier = position[:, None] < position[None]
    nearest = jnp.max(jnp.where(earlier, one.path, 0.0), axis=0)
    tree = jnp.where(several, jnp.sum(nearest) / jnp.maximum(size - 1.0, 1.0), 0.0)

    pairs = jnp.sum(one.degree, dtype=jnp.int32).astype(scalar) / 2.0
    pair_share = jnp.where(several, pairs / jnp.maximum(size * (size - 1.0) / 2.0, 1.0), 0.0)
    linked = jnp.sum(member & (one.degree > 0), dtype=jnp.int32).astype(scalar)
    linked_share = linked / jnp.maximum(size, 1.0)
    isolated = jnp.any(member & (one.degree < t.min_links))

    gated = t.min_link > 0.0
    density = tree * jnp.where(gated, _power(pair_share, t.density_power), 1.0)
    connection = _power(linked_share, t.linked_power) * _power(pair_share, t.pairs_power)
    connection = jnp.where(isolated, 0.0, connection)
    mean, coherence = _mean_maturity(one, links, t)
    return Cohesion(
        density=jnp.clip(density, 0.0, 1.0),
        connection=jnp.where(several & gated, connection, 1.0),
        maturity=mean,
        reliability=jnp.where(t.maturity, _power(coherence, t.maturity_power), 1.0),
    )


def _mean_maturity(
    one: MemberSet, links: Links, t: Sets
) -> tuple[Float[Array, ""], Float[Array, ""]]:
    """Arithmetic and power mean of the maturities, 0 for the empty set."""
    floored = jnp.maximum(_FLOOR, links.maturity)
    geometric = jnp.abs(t.maturity_mean) <= _FLOOR
    exponent = jnp.where(geometric, 1.0, t.maturity_mean)
    power = jnp.where(geometric, jnp.log(floored), floored**exponent)
    plain_and_power = jnp.pad(jnp.stack([links.maturity, power], axis=1), ((0, 1), (0, 0)))
    size = jnp.maximum(one.size, 1).astype(one.path.dtype)
    mean, mean_power = sum_in_order(plain_and_power[one.ordered]) / size
    coherence = jnp.where(
        geometric, jnp.exp(mean_power), jnp.maximum(0.0, mean_power) ** (1.0 / exponent)
    )
    coherence = jnp.where(one.size == 1, mean, jnp.clip(coherence, 0.0, 1.0))
    return mean, jnp.where(one.size > 0, coherence, 0.0)


def _power(share: Float[Array, ""], exponent: Float[Array, ""]) -> Float[Array, ""]:
    """`share` in [0, 1] to a power; powers that are not positive leave it out."""
    return jnp.where(exponent > 0.0, jnp.clip(share, 0.0, 1.0) ** exponent, 1.0)
