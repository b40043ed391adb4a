"""Every choice of objects that the sets of a beam can make (context notes 7.5, 7.6).

Sets are worked through a few at a time, because most beams hold far fewer sets than rows. Letters:
`W` sets, of which the first `num_sets` count, `K` most detections per class, `O` objects.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Int

from remind_jax.config.context_thresholds import Sets
from remind_jax.context.evidence import Links
from remind_jax.context.member_sets import (
    Bonds,
    Cohesion,
    MemberSet,
    add_member,
    introduce,
    rate_cohesion,
)
from remind_jax.context.options import VARIANTS

_CHUNK = 16  # sets worked on at once


def rate_choices(
    sets: MemberSet,
    num_sets: Int[Array, ""],
    ranked: Int[Array, "W K+1"],
    largest: Int[Array, ""],
    links: Links,
    t: Sets,
) -> Cohesion:
    """Cohesion of every set after every choice of objects `[W, K+1, 2]`.

    The choices of a set grow by one object at a time: each count adds one to the best choice of
    the count before, or the one after it.

    Args:
      sets: Sets before the choice.
      num_sets: How many of them count.
      ranked: Objects to choose from, best first, none a member yet.
      largest: Most objects that may be chosen.
      links: Ties between objects.
      t: Thresholds.
    """
    counts = ranked.shape[1]
    add = jax.vmap(add_member, (0, 0, None))
    rate = jax.vmap(rate_cohesion, (0, None))

    def grow(rows: tuple[MemberSet, Array]) -> Cohesion:
        sets, ranked = rows
        newcomers = jax.vmap(introduce, (0, 0, None))(sets, ranked, links)
        table = jax.tree.map(
            lambda leaf: jnp.broadcast_to(leaf, (counts, VARIANTS, *leaf.shape)),
            rate(sets.bonds, t),
        )

        def step(count: Array, carry: tuple[Bonds, Cohesion]) -> tuple[Bonds, Cohesion]:
            best, table = carry
            other, best = add(best, newcomers, count), add(best, newcomers, count - 1)
            for variant, bonds in enumerate((best, other)):
                table = jax.tree.map(
                    lambda whole, new, at=variant: whole.at[count, at].set(new),
                    table,
                    rate(bonds, t),
                )
            return best, table

        _, table = jax.lax.fori_loop(1, largest + 1, step, (sets.bonds, table))
        return jax.tree.map(lambda leaf: jnp.moveaxis(leaf, 2, 0), table)

    return _by_chunks(grow, (sets, ranked), num_sets)


def join_chosen(
    sets: MemberSet,
    parent: Int[Array, "W"],
    chosen: Int[Array, "W K"],
    largest: Int[Array, ""],
    num_sets: Int[Array, ""],
    links: Links,
) -> MemberSet:
    """Makes new sets from parent sets and the objects chosen for them."""

    def grow(rows: tuple[Array, Array]) -> MemberSet:
        parent, chosen = rows
        start = jax.tree.map(lambda leaf: leaf[parent], sets)
        newcomers = jax.vmap(introduce, (0, 0, None))(start, chosen, links)
        add = jax.vmap(add_member, (0, 0, None))
        bonds = jax.lax.fori_loop(
            0, largest, lambda place, bonds: add(bonds, newcomers, place), start.bonds
        )
        named = chosen[:, :, None] == jnp.arange(start.members.shape[1])
        return MemberSet(start.members | jnp.any(named, axis=1), newcomers.slot, bonds)

    return _by_chunks(grow, (parent, chosen), num_sets)


def members_by_choice(
    members: Bool[Array, "W O"], ranked: Int[Array, "W K+1"]
) -> Bool[Array, "O W K+1 2"]:
    """Who is in a set after each choice of objects."""
    slot = jnp.arange(members.shape[1])
    named = ranked[:, None, :] == slot[:, None]
    rank = jnp.where(jnp.any(named, axis=2), jnp.argmax(named, axis=2), ranked.shape[1])
    rank = rank.T[:, :, None, None]
    count = jnp.arange(ranked.shape[1])[:, None]
    last = count - 1 + jnp.arange(VARIANTS)
    taken = ((rank < count - 1) | (rank == last)) & (count > 0)
    return members.T[:, :, None, None] | taken


def _by_chunks(function: Callable[[Any], Any], rows: Any, used: Int[Array, ""]) -> Any:
    """Applies a function of rows to the used ones, a few at a time; the others give zeros."""
    width = jax.tree.leaves(rows)[0].shape[0]
    length = min(_CHUNK, width)
    part = lambda start: jax.tree.map(  # noqa: E731
        lambda leaf: jax.lax.dynamic_slice_in_dim(leaf, start, length), rows
    )
    shapes = jax.eval_shape(lambda: function(part(0)))
    results = jax.tree.map(lambda leaf: jnp.zeros((width, *leaf.shape[1:]), leaf.dtype), shapes)

    def step(chunk: Array, results: Any) -> Any:
        # The last chunk may reach back to rows that are done; they come out the same.
        start = jnp.minimum(chunk * length, width - length)
        return jax.tree.map(
            lambda whole, new: jax.lax.dynamic_update_slice_in_dim(whole, new, start, axis=0),
            results,
            function(part(start)),
        )

    return jax.lax.fori_loop(0, (used + length - 1) // length, step, results)
