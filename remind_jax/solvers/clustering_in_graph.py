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
from remind_jax.solvers.assignment_in_graph import double_precision

_ROWS = 64  # of a block; the last one of a set is filled up with rows that do not count
_BLOCKS_AT_ONCE = 16
# Words kept in reserve for rejected draws; one is rejected with a probability of P / 2^32.
_SPARE_WORDS = 4


class _Members(NamedTuple):
    """The members of all sets, in blocks; the blocks of a set follow each other."""

    points: Float[Array, "P D"]
    point: Int[Array, "L B"]  # in each row, by rising order within a set
    valid: Bool[Array, "L B"]
    owner: Int[Array, "L"]  # set of each block, N: not in use
    start: Int[Array, "N"]  # first block of each set
    num_blocks: Int[Array, ""]  # in use
    exists: Bool[Array, "N K"]  # clusters that the set has
    drawn: Int[Array, "N T"]  # points drawn at random, in order of use


class _Found(NamedTuple):
    """What one look at all members against the centers finds."""

    turn: Int[Array, ""]  # of the loop over blocks
    nearest: Int[Array, "L B"]  # center
    reached: Float[Array, "L B"]  # squared distance to it
    number: Float[Array, "N K"]  # of members nearest to each center
    sums: Float[Array, "N K D"]


class _Restart(NamedTuple):
    """State of a restart between two turns."""

    turn: Int[Array, ""]
    centers: Float[Array, "N K D"]
    labels: Int[Array, "L B"]
    reached: Float[Array, "L B"]
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
      points: Points shared by all sets.
      members: Which points belong to each set.
      wanted: Clusters of each set, at most `clusters`; a set never has more than points.
      clusters: K.
      iterations: Most rounds of one restart.
      restarts: Number of restarts.
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
        return end.used, (end.labels, end.centers, end.reached)

    _, (labels, centers, reached) = lax.scan(run, jnp.zeros_like(count), length=restarts)
    with double_precision():
        of_blocks = jnp.sum(reached.astype(jnp.float64), axis=2)
        inertia = jnp.sum(jnp.where(_owned(held)[None], of_blocks[:, None], 0.0), axis=2)
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
    each = -(-size // _ROWS)
    listed = jnp.sort(jnp.where(members, jnp.arange(size, dtype=jnp.int32)[None], size), axis=1)
    blocks = (count + _ROWS - 1) // _ROWS
    set_index = jnp.arange(num)
    upto = set_index[:, None] >= set_index[None]
    end = jnp.sum(jnp.where(upto, blocks[None], 0), axis=1, dtype=jnp.int32)
    most = -(-num * each // _BLOCKS_AT_ONCE) * _BLOCKS_AT_ONCE
    index = jnp.arange(most, dtype=jnp.int32)
    owner = jnp.sum(end[None] <= index[:, None], axis=1, dtype=jnp.int32)
    start = end - blocks
    own = jnp.minimum(owner, num - 1)
    rank = (index - start[own])[:, None] * _ROWS + jnp.arange(_ROWS, dtype=jnp.int32)[None]
    point = listed[own[:, None], jnp.minimum(rank, size - 1)]
    valid = (rank < count[own][:, None]) & (owner < num)[:, None]
    return _Members(
        points=points,
        point=jnp.minimum(point, size - 1),
        valid=valid,
        owner=owner,
        start=start,
        num_blocks=end[-1],
        exists=exists,
        drawn=jnp.take_along_axis(listed, numbers, axis=1),
    )


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
        found = _measure(held, state.centers, placed, ~placing)
        farthest, apart = _find_farthest(held, found.reached)
        labels = jnp.where(placing, NO_SLOT, found.nearest)
        stays = jnp.all((labels == state.labels) & ~placing | ~held.valid, axis=1)
        settled = state.settled | jnp.all(stays[None] | ~_owned(held), axis=1)

        empty = held.exists & (found.number == 0) & ~settled[:, None]
        is_next = held.exists & (index == state.turn)[None]
        draws = jnp.where(placing, is_next & ~apart[:, None], empty)
        earlier = index[None] < index[:, None]
        before = jnp.sum(draws[:, None] & earlier[None], axis=2, dtype=jnp.int32)
        drawn = _draw(held, used=state.used[:, None] + before)
        point = jnp.where(is_next & apart[:, None], farthest[:, None], drawn)
        renewed = jnp.where(placing, is_next, empty)
        stay = placing | settled[:, None]
        centers = jnp.where(stay[..., None], state.centers, _means(found))
        return _Restart(
            turn=state.turn + 1,
            centers=jnp.where(renewed[..., None], held.points[point], centers),
            labels=labels,
            reached=found.reached,
            settled=settled,
            used=state.used + jnp.sum(draws, axis=1, dtype=jnp.int32),
        )

    start = _Restart(
        turn=jnp.int32(1),
        centers=jnp.broadcast_to(first, (num, clusters, first.shape[-1])),
        labels=jnp.full(held.point.shape, NO_SLOT, jnp.int32),
        reached=jnp.zeros(held.point.shape, first.dtype),
        settled=~held.exists[:, 0],
        used=used + 1,
    )
    return repeat(unfinished, advance, start)


def _measure(
    held: _Members,
    centers: Float[Array, "N K D"],
    placed: Bool[Array, "N K"],
    sums_up: Bool[Array, ""],
) -> _Found:
    """Looks at all members, a few blocks at a time."""
    num, clusters = placed.shape
    norms, squares = _square(held.points), jnp.where(placed, _square(centers), jnp.inf)
    index, clusters_index = (jnp.arange(size, dtype=jnp.int32) for size in (num, clusters))

    def look(found: _Found) -> _Found:
        at = found.turn * _BLOCKS_AT_ONCE
        owner, point, valid = (
            lax.dynamic_slice_in_dim(leaf, at, _BLOCKS_AT_ONCE)
            for leaf in (held.owner, held.point, held.valid)
        )
        own = jnp.minimum(owner, num - 1)
        rows = held.points[point]
        product = jnp.einsum("sbd,skd->sbk", rows, centers[own], precision="highest")
        distance = norms[point][..., None] - 2.0 * product + squares[own][:, None]
        nearest = jnp.argmin(distance, axis=2).astype(jnp.int32)
        reached = jnp.where(valid, jnp.min(distance, axis=2), 0.0)

        def add() -> tuple[Array, Array]:
            inside = (nearest[:, None] == clusters_index[None, :, None]) & valid[:, None]
            mine = (owner[None] == index[:, None]).astype(rows.dtype)
            inside = inside.astype(rows.dtype)
            sums = jnp.einsum("skb,sbd->skd", inside, rows, precision="highest")
            return (
                found.number + jnp.einsum("ns,sk->nk", mine, jnp.sum(inside, axis=2)),
                found.sums + jnp.einsum("ns,skd->nkd", mine, sums, precision="highest"),
            )

        number, sums = branch(sums_up, add, lambda: (found.number, found.sums))
        return _Found(
            turn=found.turn + 1,
            nearest=lax.dynamic_update_slice_in_dim(found.nearest, nearest, at, axis=0),
            reached=lax.dynamic_update_slice_in_dim(found.reached, reached, at, axis=0),
            number=number,
            sums=sums,
        )

    turns = (held.num_blocks + _BLOCKS_AT_ONCE - 1) // _BLOCKS_AT_ONCE
    nothing = _Found(
        turn=jnp.int32(0),
        nearest=jnp.zeros(held.point.shape, jnp.int32),
        reached=jnp.zeros(held.point.shape, centers.dtype),
        number=jnp.zeros(placed.shape, centers.dtype),
        sums=jnp.zeros_like(centers),
    )
    return repeat(lambda found: found.turn < turns, look, nothing)


def _means(found: _Found) -> Float[Array, "N K D"]:
    # XLA turns division by a broadcast into a product with the reciprocal, and the mean of equal
    # points would differ from them; the barrier keeps the division.
    divisor = jnp.broadcast_to(jnp.maximum(found.number, 1.0)[..., None], found.sums.shape)
    return found.sums / lax.optimization_barrier(divisor)


def _find_farthest(
    held: _Members, reached: Float[Array, "L B"]
) -> tuple[Int[Array, "N"], Bool[Array, "N"]]:
    """The first member farthest from all centers, and whether it is apart from them."""
    row = jnp.argmax(reached, axis=1)
    top = jnp.max(reached, axis=1)
    block = jnp.argmax(jnp.where(_owned(held), top[None], -jnp.inf), axis=1)
    return held.point[block, row[block]], top[block] > 0


def _owned(held: _Members) -> Bool[Array, "N L"]:
    """Which blocks belong to each set."""
    return held.owner[None] == jnp.arange(len(held.start), dtype=jnp.int32)[:, None]


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
