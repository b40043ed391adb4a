"""The order in which CPython iterates a set of ids, by which the original breaks ties.

The original keeps the surroundings of an object and the objects of a class as sets: the edges of
one episode, and candidates without any evidence, come in the order of a hash table
(method.md#set-order). It is rising by id while every id is smaller than the table; a memory of
some tens of objects is past that.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Int

from remind_jax.numerics.absent import NO_SLOT
from remind_jax.numerics.control_flow import count_up, repeat
from remind_jax.numerics.ranks import rank_rising

_SMALLEST = 8  # slots of the smallest table
_RUN = 10  # neighboring slots tried before the probe jumps
_SHIFT = 5  # bits of the id that leave the jump at every probe


def copied_size(num: Int[Array, "..."]) -> Int[Array, "..."]:
    """Slots of the table that a copy of a set of `num` ids gets."""
    powers = 1 << jnp.arange(3, 31, dtype=jnp.int32)
    fitting = jnp.where(powers > 2 * num[..., None], powers, powers[-1])
    return jnp.where(num < 5, _SMALLEST, jnp.min(fitting, axis=-1))


def iteration_rank(
    ids: Int[Array, "K"], num: Int[Array, ""], *, copied: bool = False
) -> Int[Array, "K"]:
    """Position of every id in the iteration over the set that was filled with them.

    Args:
      ids: Different ids, in the order in which they were added; from 0.
      num: How many of them count; the others keep their places behind.
      copied: It is a copy of that set, in a table of another size.
    """
    most = ids.shape[0]
    sizes, limits = _growth(most)
    grown = jnp.array([0, *limits[:-1]], jnp.int32) <= num
    filled = jnp.where(grown, jnp.minimum(num, jnp.array(limits, jnp.int32)), 0)
    tables = jnp.array(sizes, jnp.int32)
    if copied:
        size = copied_size(num)
        again = jnp.where(size == tables[jnp.sum(grown) - 1], 0, num)
        tables, filled = jnp.append(tables, size), jnp.append(filled, again)
    # The largest table of all: a copy of `most` ids, or the one that was grown.
    room = max(sizes[-1], _SMALLEST, 1 << (2 * most).bit_length())

    def rebuild(rank: Array, table: tuple[Array, Array]) -> tuple[Array, None]:
        return rank_rising([_fill_table(ids, rank, *table, room)]), None

    return jax.lax.scan(rebuild, jnp.arange(most, dtype=jnp.int32), (tables, filled))[0]


def _growth(most: int) -> tuple[list[int], list[int]]:
    """Tables that a set passes through while ids are added, and the fill that outgrows each."""
    sizes, limits = [_SMALLEST], []
    while True:
        limits.append(-(-3 * (sizes[-1] - 1) // 5))
        if limits[-1] > most:
            return sizes, limits
        sizes.append(1 << (4 * limits[-1]).bit_length())


def _fill_table(
    ids: Int[Array, "K"],
    rank: Int[Array, "K"],
    size: Int[Array, ""],
    count: Int[Array, ""],
    room: int,
) -> Int[Array, "K"]:
    """Slot of each of the first `count` ids by rank in an empty table; the others follow."""

    def add(turn: Array, carry: tuple[Array, Array]) -> tuple[Array, Array]:
        taken, slot = carry
        added = rank == turn
        found = _free_slot(taken, jnp.sum(jnp.where(added, ids, 0), dtype=ids.dtype), size)
        return taken | (jnp.arange(taken.shape[0]) == found), jnp.where(added, found, slot)

    # Room for the run of the last slots.
    taken = jnp.zeros(room + _RUN, bool)
    return count_up(count, add, (taken, room + rank))[1]


def _free_slot(
    taken: Bool[Array, "R"], number: Int[Array, ""], size: Int[Array, ""]
) -> Int[Array, ""]:
    """First free slot on the probe sequence of an id."""
    steps = jnp.arange(_RUN, dtype=jnp.int32)

    def probe(carry: tuple[Array, Array, Array]) -> tuple[Array, Array, Array]:
        """Tries the run of neighbors at a slot, and names the next one; goes on until it finds."""
        start, perturb, _ = carry
        tried = (steps == 0) | (start + _RUN <= size)
        free = tried & ~jax.lax.dynamic_slice(taken, (start,), (_RUN,))
        first = jnp.min(jnp.where(free, steps, _RUN))
        rest = perturb >> _SHIFT
        following = (5 * start + 1 + rest) & (size - 1)
        found = first < _RUN
        place = jnp.where(found, start + first, NO_SLOT)
        return jnp.where(found, start, following), jnp.where(found, perturb, rest), place

    begin = (number & (size - 1), number, jnp.full_like(number, NO_SLOT))
    return repeat(lambda carry: carry[2] == NO_SLOT, probe, begin)[2]
