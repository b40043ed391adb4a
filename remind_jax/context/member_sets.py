"""Sets of objects that grow one member at a time (paper III-D; context notes 7.6).

The density of a set is the mean link of its maximum spanning tree. Instead of a tree, a set carries
the strength of the best path between any two members, where a path is as strong as its weakest
link. A new member updates all paths at once, and the tree weighs as much as the sum of the best
path from each member to an earlier one. Functions are written for one set; callers `vmap`.
Letters: `M` most members of a set, `J` newcomers, `O` object slots, `B` sets.
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
class Bonds:
    """How the members of one set are tied to each other, in order of entry."""

    size: Int[Array, ""]
    path: Float[Array, "M M"]  # strength of the best path between two members
    degree: Int[Array, "M"]  # members that each member has been seen with


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class MemberSet:
    """One set of objects."""

    members: Bool[Array, "O"]
    slot: Int[Array, "M"]  # members in order of entry, NOBODY behind them
    bonds: Bonds


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Newcomers:
    """Objects that may enter a set, with their ties to it and to each other."""

    real: Bool[Array, "J"]  # the others change nothing
    slot: Int[Array, "M"]  # members once all have entered in this order
    strength: Float[Array, "J M"]
    present: Bool[Array, "J M"]


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Cohesion:
    """How well sets hold together, any leading shape."""

    density: Float[Array, "..."]  # [0, 1]; says nothing below two members
    connection: Float[Array, "..."]  # [0, 1], factor of the score


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Trust:
    """How well the members of sets are known, any leading shape."""

    maturity: Float[Array, "..."]  # mean over the members, [0, 1)
    reliability: Float[Array, "..."]  # [0, 1], factor of the score


def empty_set(num_members: int, num_objects: int, scalar: jnp.dtype) -> MemberSet:
    """The set without members."""
    return MemberSet(
        members=jnp.zeros(num_objects, bool),
        slot=jnp.full(num_members, NOBODY, jnp.int32),
        bonds=Bonds(
            size=jnp.int32(0),
            path=jnp.full((num_members, num_members), _NO_PATH, scalar),
            degree=jnp.zeros(num_members, jnp.int32),
        ),
    )


def introduce(one: MemberSet, objects: Int[Array, "J"], links: Links) -> Newcomers:
    """Lines up objects behind the members of a set; none may be a member, some may be NOBODY."""
    entry = jnp.arange(one.slot.shape[0]) - one.bonds.size
    arrives = (entry >= 0) & (entry < objects.shape[0])
    slot = jnp.where(arrives, objects[jnp.clip(entry, 0, objects.shape[0] - 1)], one.slot)
    pair = (jnp.maximum(objects, 0)[:, None], jnp.maximum(slot, 0)[None])
    return Newcomers(objects != NOBODY, slot, links.strength[pair], links.present[pair])


def add_member(bonds: Bonds, newcomers: Newcomers, which: Int[Array, ""]) -> Bonds:
    """Ties one newcomer to the members; those introduced before it need not have entered."""
    pick = lambda leaf: jax.lax.dynamic_index_in_dim(leaf, which, keepdims=False)  # noqa: E731
    real = pick(newcomers.real)
    position = jnp.arange(bonds.degree.shape[0])
    entry = (position == bonds.size) & real
    # The path matrix is symmetric: the reduced axis comes first, so that the last one stays whole.
    link = jnp.where(real, pick(newcomers.strength), _NO_PATH)
    reach = jnp.max(jnp.minimum(link[:, None], bonds.path), axis=0)
    reach = jnp.where(entry, _OWN, reach)
    seen = pick(newcomers.present) & (position < bonds.size) & real
    return Bonds(
        size=bonds.size + real,
        path=jnp.maximum(bonds.path, jnp.minimum(reach[:, None], reach[None])),
        degree=jnp.where(entry, jnp.sum(seen, dtype=jnp.int32), bonds.degree + seen),
    )


def rate_cohesion(bonds: Bonds, t: Sets) -> Cohesion:
    """Density and connection of a set (notes 7.6)."""
    scalar = bonds.path.dtype
    size = bonds.size.astype(scalar)
    several = bonds.size >= 2
    position = jnp.arange(bonds.degree.shape[0])
    member = position < bonds.size
    earlier = position[:, None] < position[None]
    nearest = jnp.max(jnp.where(earlier, bonds.path, 0.0), axis=0)
    tree = jnp.sum(nearest) / jnp.maximum(size - 1.0, 1.0)

    pairs = jnp.sum(bonds.degree, dtype=jnp.int32).astype(scalar) / 2.0
    pair_share = pairs / jnp.maximum(size * (size - 1.0) / 2.0, 1.0)
    linked = jnp.sum(member & (bonds.degree > 0), dtype=jnp.int32).astype(scalar)
    linked_share = linked / jnp.maximum(size, 1.0)
    isolated = jnp.any(member & (bonds.degree < t.min_links))

    gated = t.min_link > 0.0
    density = tree * jnp.where(gated, _power(pair_share, t.density_power), 1.0)
    connection = _power(linked_share, t.linked_power) * _power(pair_share, t.pairs_power)
    connection = jnp.where(isolated, 0.0, connection)
    return Cohesion(
        density=jnp.clip(density, 0.0, 1.0),
        connection=jnp.where(several & gated, connection, 1.0),
    )


def rate_trust(
    members: Bool[Array, "O *B"], size: Int[Array, "*B"], maturity: Float[Array, "O"], t: Sets
) -> Trust:
    """Mean maturity of sets and how reliable their members are (notes 7.6).

    Reliability is a power of a power mean that leans towards the least mature member.
    """
    floored = jnp.maximum(_FLOOR, maturity)
    geometric = jnp.abs(t.maturity_mean) <= _FLOOR
    exponent = jnp.where(geometric, 1.0, t.maturity_mean)
    power = jnp.where(geometric, jnp.log(floored), floored**exponent)
    both = jnp.stack([maturity, power], axis=1).reshape(-1, 2, *[1] * size.ndim)
    total = sum_in_order(both, members[:, None])
    mean, mean_power = total / jnp.maximum(size, 1).astype(maturity.dtype)
    coherence = jnp.maximum(0.0, mean_power) ** (1.0 / exponent)
    coherence = jnp.where(geometric, jnp.exp(mean_power), coherence)
    coherence = jnp.where(size == 1, mean, jnp.clip(coherence, 0.0, 1.0))
    coherence = jnp.where(size > 0, coherence, 0.0)
    return Trust(mean, jnp.where(t.maturity, _power(coherence, t.maturity_power), 1.0))


def _power(share: Float[Array, "..."], exponent: Float[Array, ""]) -> Float[Array, "..."]:
    """`share` in [0, 1] to a power; powers that are not positive leave it out."""
    return jnp.where(exponent > 0.0, jnp.clip(share, 0.0, 1.0) ** exponent, 1.0)
