"""In-graph twin of k-means: all sets at once, by matrix products (method.md#k-means).

The members of a set are listed in blocks of rows, and a turn reads the blocks of all sets once: it
measures every member against the centers of its set and sums up the members nearest to each. The
first turns of a restart place the centers, one each, at the member that is farthest from those
placed; the others move them to the means. Sets of any size take the same way.

Letters: `N` point sets (detections), `P` points (patches), `D` dimensions, `K` clusters, `L` blocks
of `B` rows, `S` blocks read at once, `T` draws.
"""

from __future__ import annotations

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from remind_jax.numerics.absent import NO_SLOT
from remind_jax.numerics.control_flow import branch, repeat
from remind_jax.numerics.reductions import reduce_together
from remind_jax.numerics.rounding import divide
from remind_jax.solvers.assignment_in_graph import double_precision

_ROWS = 64  # of a block; the last one of a set is filled up with rows that do not count
# Blocks that are read at once: a multiple of the fewest.
_FEWEST_BLOCKS, _MOST_BLOCKS = 16, 64
# Words kept in reserve for rejected draws; one is rejected with a probability of P / 2^32.
_SPARE_WORDS = 4


class _Members(NamedTuple):
    """The members of all sets, in blocks; the blocks of a set follow each other.

    Masks rarely overlap, so that few of the blocks that there could be are in use. What has one
    entry per row is therefore looked up for the blocks that are read, never for all of them.
    """

    points: Float[Array, "P D"]
    norms: Float[Array, "P"]  # squared
    listed: Int[Array, "N P"]  # members by rising order, P behind them
    owner: Int[Array, "L"]  # set of each block, N: not in use
    first: Int[Array, "L"]  # place in `listed` of the first row of each block
    rows: Int[Array, "L"]  # of each block that count, the first ones
    start: Int[Array, "N"]  # first block of each set
    num_blocks: Int[Array, ""]  # in use
    exists: Bool[Array, "N K"]  # clusters that the set has
    drawn: Int[Array, "N T"]  # points drawn at random, in order of use


class _Found(NamedTuple):
    """What one look at all members against the centers finds."""

    turn: Int[Array, ""]  # of the loop over blocks
    labels: Int[Array, "L B"]  # nearest center; NO_SLOT while centers are placed
    moved: Bool[Array, "N"]  # whether some member had another label before
    farthest: Int[Array, "N"]  # the first point that is farthest from all centers
    apart: Float[Array, "N"]  # its squared distance to the nearest one
    inertia: Float[Array, "N"]  # summed squared distances
    number: Float[Array, "N K"]  # of members nearest to each center
    sums: Float[Array, "N K D"]


class _Restart(NamedTuple):
    """State of a restart between two turns."""

    turn: Int[Array, ""]
    centers: Float[Array, "N K D"]
    labels: Int[Array, "L B"]
    inertia: Float[Array, "N"]
    settled: Bool[Array, "N"]
    used: Int[Array, "N"]  # draws


def cluster_in_graph(
    points: Float[Array, "P D"],
    members: Bool[Array, "N P"],
    wanted: Int[Array, "N"],
    *,
    clusters: int,
    iterations: int,
    restarts: int,
    seed: int,
) -> tuple[Int[Array, "N P"], Float[Array, "N K D"]]:
    """Clusters the member points of each set as `remind_jax.solvers.clustering.cluster_points`.

    Labels are equal unless two distances, or the inertias of two restarts, differ by no more than
    the rounding of their sums (about 1e-6 of the squared norms), which are added in another order;
    inputs whose sums are exact, such as small whole numbers, agree in their ties as well.

    Args:
      wanted: Clusters of each set, at most `clusters`; a set never has more than points.
      seed: Seed of the draws, restarted for every set.

    Returns:
      Cluster of each point, -1 outside the set; centers, zero for clusters that do not exist.
    """
    count = jnp.sum(members, axis=1, dtype=jnp.int32)
    exists = jnp.arange(clusters)[None, :] < jnp.minimum(wanted, count)[:, None]
    numbers = _draw_numbers(count, seed, restarts * (clusters + iterations * clusters))
    held = _list_blocks(points, members, count, exists, numbers)

    def run(used, _):
        end = _run_restart(held, used, iterations)
        return end.used, (end.labels, end.centers, end.inertia)

    _, (labels, centers, inertia) = lax.scan(run, jnp.zeros_like(count), length=restarts)
    is_least = jnp.all(inertia[:, None] <= inertia[None], axis=1)
    best = jnp.argmax(is_least, axis=0)  # the first among equals
    centers = jnp.take_along_axis(centers, best[None, :, None, None], axis=0)[0]
    row = jnp.cumsum(members, axis=1, dtype=jnp.int32) - 1 + _ROWS * held.start[:, None]
    labels = labels.reshape(restarts, -1)[best[:, None], row]
    return jnp.where(members, labels, NO_SLOT), jnp.where(exists[..., None], centers, 0.0)


def _list_blocks(
    points: Float[Array, "P D"],
    members: Bool[Array, "N P"],
    count: Int[Array, "N"],
    exists: Bool[Array, "N K"],
    numbers: Int[Array, "N T"],
) -> _Members:
    """Cuts the members of all sets into blocks."""
    num, size = members.shape
    each, at_once = -(-size // _ROWS), _blocks_at_once(num)
    listed = jnp.sort(jnp.where(members, jnp.arange(size, dtype=jnp.int32)[None], size), axis=1)
    blocks = lax.div(count + _ROWS - 1, jnp.int32(_ROWS))
    end = _sum_up_to(blocks)
    start = end - blocks
    index = jnp.arange(-(-num * each // at_once) * at_once, dtype=jnp.int32)
    owner = jnp.sum(end[None] <= index[:, None], axis=1, dtype=jnp.int32)
    own = jnp.minimum(owner, num - 1)
    first = (index - start[own]) * _ROWS
    return _Members(
        points=points,
        norms=_square(points),
        listed=listed,
        owner=owner,
        first=first,
        rows=jnp.where(owner < num, count[own] - first, 0),
        start=start,
        num_blocks=end[-1],
        exists=exists,
        drawn=jnp.take_along_axis(listed, numbers, axis=1),
    )


def _blocks_at_once(num: int) -> int:
    """Blocks that are read at once: one of each set if there are not too many."""
    return min(-(-num // _FEWEST_BLOCKS), _MOST_BLOCKS // _FEWEST_BLOCKS) * _FEWEST_BLOCKS


def _run_restart(held: _Members, used: Int[Array, "N"], iterations: int) -> _Restart:
    """Places the centers, then assigns and averages in turn until the labels of all sets stay.

    If the labels of a set do not stay, its centers are one update newer than its labels.
    """
    num, clusters = held.exists.shape
    index = jnp.arange(clusters, dtype=jnp.int32)
    first = held.points[_draw(held, used)][:, None]

    def unfinished(state: _Restart) -> Bool[Array, ""]:
        return (state.turn < clusters + iterations) & ~jnp.all(state.settled)

    def advance(state: _Restart) -> _Restart:
        """Places the next center, or moves all of them."""
        placing = state.turn < clusters
        placed = held.exists & (index < state.turn)[None]
        found = _measure(held, state, placed, placing)
        apart = found.apart > 0
        settled = state.settled | ~(placing | found.moved)

        empty = held.exists & (found.number == 0) & ~settled[:, None]
        is_next = held.exists & (index == state.turn)[None]
        draws = jnp.where(placing, is_next & ~apart[:, None], empty)
        earlier = index[None] < index[:, None]
        before = jnp.sum(draws[:, None] & earlier[None], axis=2, dtype=jnp.int32)
        drawn = _draw(held, used=state.used[:, None] + before)
        point = jnp.where(is_next & apart[:, None], found.farthest[:, None], drawn)
        renewed = jnp.where(placing, is_next, empty)
        stay = placing | settled[:, None]
        means = divide(found.sums, jnp.maximum(found.number, 1.0)[..., None])
        centers = jnp.where(stay[..., None], state.centers, means)
        return _Restart(
            turn=state.turn + 1,
            centers=jnp.where(renewed[..., None], held.points[point], centers),
            labels=found.labels,
            inertia=found.inertia,
            settled=settled,
            used=state.used + jnp.sum(draws, axis=1, dtype=jnp.int32),
        )

    start = _Restart(
        turn=jnp.int32(1),
        centers=jnp.broadcast_to(first, (num, clusters, first.shape[-1])),
        labels=jnp.full((len(held.owner), _ROWS), NO_SLOT, jnp.int32),
        inertia=_no_inertia(num),
        settled=~held.exists[:, 0],
        used=used + 1,
    )
    return repeat(unfinished, advance, start)


def _measure(
    held: _Members, state: _Restart, placed: Bool[Array, "N K"], placing: Bool[Array, ""]
) -> _Found:
    """Looks at all members, a few blocks at a time."""
    num, clusters = placed.shape
    at_once, last = _blocks_at_once(num), held.points.shape[0] - 1
    squares = jnp.where(placed, _square(state.centers), jnp.inf)
    place = jnp.arange(_ROWS, dtype=jnp.int32)[None]
    cluster = jnp.arange(clusters, dtype=jnp.int32)[None, :, None]

    def look(found: _Found) -> _Found:
        at = found.turn * at_once
        owner, first, counting, labels = (
            lax.dynamic_slice_in_dim(leaf, at, at_once)
            for leaf in (held.owner, held.first, held.rows, found.labels)
        )
        own = jnp.minimum(owner, num - 1)
        mine = owner[None] == jnp.arange(num, dtype=jnp.int32)[:, None]
        valid = place < counting[:, None]
        point = held.listed[own[:, None], jnp.minimum(first[:, None] + place, last)]
        point = jnp.minimum(point, last)
        rows = held.points[point]
        product = jnp.einsum("sbd,skd->sbk", rows, state.centers[own], precision="highest")
        distance = held.norms[point][..., None] - 2.0 * product + squares[own][:, None]
        distance = jnp.swapaxes(distance, 1, 2)
        # The reduced axis is not the last one: several rows are compared by one instruction.
        least = jnp.min(distance, axis=1)
        nearest = jnp.min(jnp.where(distance <= least[:, None], cluster, clusters - 1), axis=1)
        reached = jnp.where(valid, least, 0.0)

        relabeled = jnp.where(placing, NO_SLOT, nearest)
        moves = (relabeled != labels) & valid
        top, moved, apart, inertia = _sum_up_blocks(reached, moves, mine)
        top_point = jnp.min(jnp.where(reached == top[:, None], point, last), axis=1)
        is_top = mine & (top[None] == apart[:, None])
        farthest = jnp.min(jnp.where(is_top, top_point[None], last), axis=1)
        farther = apart > found.apart

        def add() -> tuple[Array, Array]:
            inside = ((nearest[:, None] == cluster) & valid[:, None]).astype(rows.dtype)
            share = mine.astype(rows.dtype)
            sums = jnp.einsum("skb,sbd->skd", inside, rows, precision="highest")
            return (
                found.number + jnp.einsum("ns,sk->nk", share, jnp.sum(inside, axis=2)),
                found.sums + jnp.einsum("ns,skd->nkd", share, sums, precision="highest"),
            )

        number, sums = branch(~placing, add, lambda: (found.number, found.sums))
        return _Found(
            turn=found.turn + 1,
            labels=lax.dynamic_update_slice_in_dim(found.labels, relabeled, at, axis=0),
            moved=found.moved | moved,
            farthest=jnp.where(farther, farthest, found.farthest),
            apart=jnp.where(farther, apart, found.apart),
            inertia=_add(found.inertia, inertia),
            number=number,
            sums=sums,
        )

    turns = lax.div(held.num_blocks + at_once - 1, jnp.int32(at_once))
    nothing = _Found(
        turn=jnp.int32(0),
        labels=state.labels,
        moved=jnp.zeros(num, bool),
        farthest=jnp.zeros(num, jnp.int32),
        apart=jnp.zeros(num, state.centers.dtype),
        inertia=_no_inertia(num),
        number=jnp.zeros(placed.shape, state.centers.dtype),
        sums=jnp.zeros_like(state.centers),
    )
    return repeat(lambda found: found.turn < turns, look, nothing)


def _no_inertia(num: int) -> Float[Array, "N"]:
    with double_precision():
        return jnp.zeros(num, jnp.float64)


def _add(inertia: Float[Array, "N"], more: Float[Array, "N"]) -> Float[Array, "N"]:
    with double_precision():
        return inertia + more


def _sum_up_blocks(
    reached: Float[Array, "S B"], moves: Bool[Array, "S B"], mine: Bool[Array, "N S"]
) -> tuple[Float[Array, "S"], Bool[Array, "N"], Float[Array, "N"], Float[Array, "N"]]:
    """Squared distances and changed labels of the blocks that were read.

    Distances are added in float64, so that the inertias of restarts can be compared.

    Returns:
      Largest distance of each block; of each set: whether some label changed, the largest
      distance, and the sum of all.
    """
    with double_precision():
        exact = reached.astype(jnp.float64)
        top, moved, total = reduce_together(("max", exact), ("any", moves), ("sum", exact), axis=1)
        moved, apart, inertia = reduce_together(
            ("any", mine & moved[None]),
            ("max", jnp.where(mine, top[None], 0.0)),
            ("sum", jnp.where(mine, total[None], 0.0)),
            axis=1,
        )
        top, apart = top.astype(reached.dtype), apart.astype(reached.dtype)
    return top, moved, apart, inertia


def _sum_up_to(numbers: Int[Array, "N"]) -> Int[Array, "N"]:
    """The sum of the numbers up to each one."""
    index = jnp.arange(len(numbers))
    upto = index[:, None] >= index[None]
    return jnp.sum(jnp.where(upto, numbers[None], 0), axis=1, dtype=jnp.int32)


def _draw(held: _Members, used: Int[Array, "N *K"]) -> Int[Array, "N *K"]:
    """Point of the next draw of each set."""
    rows = used.reshape(len(used), -1)
    return jnp.take_along_axis(held.drawn, rows, axis=1).reshape(used.shape)


def _square(vectors: Float[Array, "... D"]) -> Float[Array, "..."]:
    return jnp.sum(vectors * vectors, axis=-1)


def _draw_numbers(count: Int[Array, "N"], seed: int, draws: int) -> Int[Array, "N T"]:
    """What `Generator.integers(0, count)` gives in turn, one stream for each set.

    The words of the generator do not depend on `count` and are a constant table. A draw is the
    upper half of word times `count`, computed in halves of 16 bits as no 64-bit integers are
    needed then; words that would favor some numbers are skipped (Lemire's method).
    """
    words = np.random.PCG64(seed).random_raw((draws + _SPARE_WORDS + 1) // 2)
    words = np.stack([words & 0xFFFFFFFF, words >> 32], axis=1).ravel().astype(np.uint32)
    limit = jnp.maximum(count, 1).astype(jnp.uint32)[:, None]
    upper, lower = _multiply(jnp.asarray(words)[None, :], limit)
    accepted = lower >= (jnp.uint32(0) - limit) % limit
    # Whole numbers far below 2^24: exact in float32.
    up_to = np.triu(np.ones((len(words), len(words)), np.float32))
    taken = jnp.dot(accepted.astype(jnp.float32), up_to, precision="highest")
    turn = np.arange(draws, dtype=np.float32)[None, :, None]
    index = jnp.sum(taken[:, None] <= turn, axis=2, dtype=jnp.int32)
    index = jnp.minimum(index, len(words) - 1)
    return jnp.take_along_axis(upper, index, axis=1).astype(jnp.int32)


def _multiply(left: Array, right: Array) -> tuple[Array, Array]:
    """Upper and lower 32 bits of the product of 32-bit unsigned integers."""
    half = jnp.uint32(0xFFFF)
    left_low, left_high = left & half, left >> 16
    right_low, right_high = right & half, right >> 16
    cross = left_high * right_low + ((left_low * right_low) >> 16)
    other = left_low * right_high + (cross & half)
    return left_high * right_high + (cross >> 16) + (other >> 16), left * right
