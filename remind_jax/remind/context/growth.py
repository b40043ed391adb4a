"""Every choice of objects that sets can make (method.md#beam-search, method.md#member-sets).

Letters: `W` sets, `K` most detections per class, `C = K + 1` counts, `O` objects, `M` most members
of a set. A choice is a count of objects, 0 to `K`, and a variant.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from remind_jax.numerics.absent import NO_SLOT
from remind_jax.numerics.control_flow import count_up
from remind_jax.numerics.reductions import reduce_together
from remind_jax.numerics.slices import put_slice, take_slice
from remind_jax.remind.context.chunks import by_chunks
from remind_jax.remind.context.evidence import Links
from remind_jax.remind.context.member_sets import (
    LinkCounts,
    MemberSet,
    extend_paths,
    line_up,
    link_strengths,
    reach_members,
    tree_edges,
)
from remind_jax.remind.context.options import VARIANTS
from remind_jax.remind.thresholds.context import Sets

_OUTSIDE = -1.0  # instead of the number of links of what is not in a set
_extend = jax.vmap(extend_paths)
_reach = jax.vmap(reach_members)
_strengths = jax.vmap(link_strengths, (0, 0, None), out_axes=1)


def choice_mask(places: int) -> Bool[Array, "C 2 C"]:
    """Which of the ranked objects each choice takes: the first, the last one moved on or not."""
    place, count = jnp.arange(places), jnp.arange(places)[:, None, None]
    last = count - 1 + jnp.arange(VARIANTS)[:, None]
    return ((place < count - 1) | (place == last)) & (count > 0)


def members_by_choice(
    members: Bool[Array, "W O"], ranked: Int[Array, "W C"]
) -> Bool[Array, "O W C 2"]:
    """Who is in a set after each choice."""
    places = ranked.shape[1]
    place = jnp.arange(places)
    named = ranked[None] == jnp.arange(members.shape[1])[:, None, None]
    rank = jnp.min(jnp.where(named, place, places), axis=2)[:, :, None, None]
    # As `choice_mask`, which would have to be looked up for every object.
    count, variant = place[:, None], jnp.arange(VARIANTS)
    taken = (rank < count - 1) | (rank == count - 1 + variant)
    return members.T[:, :, None, None] | (taken & (count > 0))


def grow_trees(
    sets: MemberSet, ranked: Int[Array, "W C"], largest: Int[Array, ""], links: Links
) -> Float[Array, "W C 2"]:
    """Weight of the spanning tree of every set after every choice among `ranked`, no members yet.

    The choices of a set grow by one object at a time: each count adds one to the best choice of
    the count before, or the one after it.
    """
    strength = _strengths(ranked, jax.vmap(line_up)(sets, ranked), links)
    edges = jax.vmap(tree_edges)(sets.path)
    table = jnp.broadcast_to(jnp.sum(edges, axis=1), (ranked.shape[1], VARIANTS, ranked.shape[0]))

    def step(count: Array, carry: tuple[Array, Array, Array]) -> tuple[Array, Array, Array]:
        path, edges, table = carry
        both = take_slice(strength, count - 1, VARIANTS)
        reach = jax.vmap(_reach, (None, 0))(path, both)
        # The newcomer counts as the first of all, so that it adds nothing of its own, and for the
        # others as one more that is earlier.
        grown = jnp.maximum(edges[None], reach)
        table = put_slice(table, jnp.sum(grown, axis=2)[None], count)
        return _extend(path, reach[0], sets.size + count - 1), grown[0], table

    _, _, table = count_up(largest + 1, step, (sets.path, edges, table), first=1)
    return jnp.moveaxis(table, 2, 0)


def count_links(sets: MemberSet, ranked: Int[Array, "W C"], links: Links, t: Sets) -> LinkCounts:
    """Links within every set after every choice `[W, K+1, 2]` (method.md#member-sets)."""
    # Counts are small whole numbers: exact in every precision that a product may take.
    present = links.present.astype(jnp.float32)
    degree = jnp.matmul(sets.members.astype(jnp.float32), present)
    at, slot = jnp.maximum(ranked, 0), jnp.maximum(sets.slot, 0)
    taken = choice_mask(ranked.shape[1])
    chosen = taken.astype(jnp.float32)
    to_members = present[at[:, :, None], slot[:, None, :]]
    to_chosen = present[at[:, :, None], at[:, None, :]]
    old = jnp.take_along_axis(degree, slot, axis=1)[:, None, None]
    old = old + jnp.einsum("kvj,wjm->wkvm", chosen, to_members)
    new = jnp.take_along_axis(degree, at, axis=1)[:, None, None]
    new = new + jnp.einsum("kvj,wji->wkvi", chosen, to_chosen)
    is_member = (jnp.arange(slot.shape[1]) < sets.size[:, None])[:, None, None]
    inside = [jnp.where(is_member, old, _OUTSIDE), jnp.where(taken[None], new, _OUTSIDE)]
    degree = jnp.concatenate(inside, axis=3)
    degrees, linked, isolated = reduce_together(
        ("sum", jnp.maximum(degree, 0.0)),
        ("sum", degree > 0.0),
        ("any", (degree > _OUTSIDE) & (degree < t.min_links.astype(jnp.float32))),
        axis=3,
    )
    scalar = links.strength.dtype
    return LinkCounts(degrees.astype(scalar) / 2.0, linked.astype(scalar), isolated)


def join_chosen(
    sets: MemberSet,
    parent: Int[Array, "W"],
    chosen: Int[Array, "W K"],
    largest: Int[Array, ""],
    num_sets: Int[Array, ""],
    links: Links,
) -> MemberSet:
    """Makes new sets, each of its parent and the objects chosen for it, NO_SLOT behind them."""

    def grow(rows: tuple[Array, Array]) -> MemberSet:
        parent, chosen = rows
        start = jax.tree.map(lambda leaf: leaf[parent], sets)
        slot = jax.vmap(line_up)(start, chosen)
        strength = _strengths(chosen, slot, links)
        entry = jnp.where(chosen != NO_SLOT, start.size[:, None] + jnp.arange(chosen.shape[1]), -1)

        def enter(place: Array, path: Array) -> Array:
            return _extend(path, _reach(path, strength[place]), entry[:, place])

        path = count_up(largest, enter, start.path, suits_all=True)
        named = chosen[:, :, None] == jnp.arange(start.members.shape[1])
        size = start.size + jnp.sum(chosen != NO_SLOT, axis=1, dtype=jnp.int32)
        return MemberSet(start.members | jnp.any(named, axis=1), slot, size, path)

    return by_chunks(grow, (parent, chosen), num_sets)
