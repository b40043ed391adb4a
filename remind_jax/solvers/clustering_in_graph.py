"""In-graph twin of k-means: all sets at once, by matrix products (method.md#k-means).

No array is larger than sets x clusters x points, or than sets x share of the points x dimensions.

Letters: `N` point sets (detections), `P` points (patches), `Q` rows in which the members of a set
are held, `D` dimensions, `K` clusters, `R` restarts, `T` draws.
"""

from __future__ import annotations

from functools import partial
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from remind_jax.numerics.absent import NO_SLOT
from remind_jax.numerics.control_flow import batch_max, repeat
from remind_jax.solvers.assignment_in_graph import double_precision

# If no set holds more than such a share of the points, members are gathered and each set is
# compared with its own only; beyond, one product with all points is faster (12 sets of 100 in
# 3,600 points on two cores: 7 ms gathered at 1/16, 18 ms at 1/8, 35 ms at 1/4, 31 ms with all).
_GATHERED_SHARES = (1 / 16, 1 / 8)
# Words kept in reserve for rejected draws; one is rejected with a probability of P / 2^32.
_SPARE_WORDS = 4


class _Sets(NamedTuple):
    """The members of each set, among the rows in which they are held."""

    rows: Float[Array, "N Q D"] | Float[Array, "Q D"]  # own rows of each set, or shared ones
    norms: Float[Array, "N Q"] | Float[Array, "Q"]  # squared
    valid: Bool[Array, "N Q"]
    exists: Bool[Array, "N K"]  # clusters that the set has
    draws: Int[Array, "N T"]  # rows drawn at random, in order of use


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
      restarts: R.
      seed: Seed of the draws, restarted for every set.

    Returns:
      Cluster of each point, -1 outside the set; centers, zero for clusters that do not exist.
    """
    count = jnp.sum(members, axis=1, dtype=jnp.int32)
    exists = jnp.arange(clusters)[None, :] < jnp.minimum(wanted, count)[:, None]
    most_draws = restarts * (clusters + iterations * clusters)
    numbers = _draw_numbers(count, seed, most_draws)
    rank = jnp.cumsum(members, axis=1, dtype=jnp.int32)
    run = partial(_run_restarts, iterations=iterations, restarts=restarts)

    def gathered(size: int):
        inside = jnp.arange(size)[None, :] < count[:, None]
        index = _locate(rank, jnp.broadcast_to(jnp.arange(size, dtype=jnp.int32), inside.shape))
        rows = jnp.where(inside[..., None], points[index], 0.0)
        labels, centers = run(_Sets(rows, _square(rows), inside, exists, numbers))
        own = jnp.clip(rank - 1, 0, size - 1)
        return jnp.take_along_axis(labels, own, axis=1), centers

    def shared():
        return run(_Sets(points, _square(points), members, exists, _locate(rank, numbers)))

    sizes = [max(1, round(share * points.shape[0])) for share in _GATHERED_SHARES]
    too_small = batch_max(jnp.max(count)) > jnp.array(sizes)
    branches = [*(partial(gathered, size) for size in sizes), shared]
    labels, centers = lax.switch(jnp.sum(too_small, dtype=jnp.int32), branches)
    return jnp.where(members, labels, NO_SLOT), jnp.where(exists[..., None], centers, 0.0)


def _run_restarts(
    sets: _Sets, *, iterations: int, restarts: int
) -> tuple[Int[Array, "N Q"], Float[Array, "N K D"]]:
    """Labels and centers of the restart of least inertia, the first among equals."""

    def run(used, _):
        centers, used = _spread_centers(sets, used)
        labels, centers, reached, used = _refine(sets, centers, used, iterations)
        return used, (labels, centers, reached)

    used = jnp.zeros(len(sets.valid), jnp.int32)
    _, (labels, centers, reached) = lax.scan(run, used, length=restarts)
    with double_precision():
        inertia = jnp.sum(reached.astype(jnp.float64), axis=2)
        is_least = jnp.all(inertia[:, None] <= inertia[None], axis=1)
    best = jnp.argmax(is_least, axis=0)
    at = best[None, :, None]
    labels = jnp.take_along_axis(labels, at, axis=0)[0]
    return labels, jnp.take_along_axis(centers, at[..., None], axis=0)[0]


def _spread_centers(
    sets: _Sets, used: Int[Array, "N"]
) -> tuple[Float[Array, "N K D"], Int[Array, "N"]]:
    """One drawn point, then always the point farthest from those chosen."""
    num, clusters = sets.exists.shape

    def gap_to(index):
        gap = _squared_distances(sets, _pick(sets.rows, index[:, None]))[:, 0]
        return jnp.where(sets.valid, gap, -jnp.inf)

    def choose(rank, carry):
        chosen, gap, used = carry
        apart = jnp.any(gap > 0, axis=1)
        index = jnp.where(apart, jnp.argmax(gap, axis=1), _next_draw(sets, used))
        used = used + (~apart & sets.exists[:, rank])
        chosen = jnp.where((jnp.arange(clusters) == rank)[None, :], index[:, None], chosen).astype(
            jnp.int32
        )
        return chosen, jnp.minimum(gap, gap_to(index)), used

    first = _next_draw(sets, used)
    chosen = jnp.broadcast_to(first[:, None], (num, clusters)).astype(jnp.int32)
    chosen, _, used = lax.fori_loop(1, clusters, choose, (chosen, gap_to(first), used + 1))
    return _pick(sets.rows, chosen), used


def _refine(
    sets: _Sets, centers: Float[Array, "N K D"], used: Int[Array, "N"], iterations: int
) -> tuple[Int[Array, "N Q"], Float[Array, "N K D"], Float[Array, "N Q"], Int[Array, "N"]]:
    """Assigns and averages in turn until the labels of a set stay, or for the given rounds.

    Returns:
      Labels, centers, squared distance of each member to its center (0 elsewhere), draws used.
      After the last round centers are one update newer than labels.
    """

    def unfinished(carry):
        turn, _, _, _, settled, _ = carry
        return (turn < iterations) & ~jnp.all(settled)

    def advance(carry):
        turn, labels, centers, reached, settled, used = carry
        distance = _squared_distances(sets, centers)
        distance = jnp.where(sets.exists[..., None], distance, jnp.inf)
        nearest = jnp.argmin(distance, axis=1).astype(jnp.int32)
        reached = jnp.where(settled[:, None], reached, jnp.min(distance, axis=1))
        settled = settled | jnp.all((nearest == labels) | ~sets.valid, axis=1)
        labels = jnp.where(settled[:, None], labels, nearest)
        means, used = _average(sets, labels, used, settled)
        centers = jnp.where(settled[:, None, None], centers, means)
        return turn + 1, labels, centers, reached, settled, used

    labels = jnp.full(sets.valid.shape, NO_SLOT, jnp.int32)
    reached = jnp.zeros(sets.valid.shape, centers.dtype)
    settled = ~jnp.any(sets.valid, axis=1)
    carry = (jnp.int32(0), labels, centers, reached, settled, used)
    _, labels, centers, reached, _, used = repeat(unfinished, advance, carry)
    return labels, centers, jnp.where(sets.valid, reached, 0.0), used


def _average(
    sets: _Sets, labels: Int[Array, "N Q"], used: Int[Array, "N"], settled: Bool[Array, "N"]
) -> tuple[Float[Array, "N K D"], Int[Array, "N"]]:
    """Mean of each cluster; an empty one gets a drawn point."""
    clusters = jnp.arange(sets.exists.shape[1], dtype=jnp.int32)
    inside = (labels[:, None] == clusters[None, :, None]) & sets.valid[:, None]
    count = jnp.sum(inside, axis=2, dtype=jnp.int32)
    form = "nkq,qd->nkd" if sets.rows.ndim == 2 else "nkq,nqd->nkd"
    sums = jnp.einsum(form, inside.astype(sets.rows.dtype), sets.rows, precision="highest")
    # XLA turns division by a broadcast into a product with the reciprocal, and the mean of equal
    # points would differ from them; the barrier keeps the division.
    divisor = jnp.broadcast_to(jnp.maximum(count, 1).astype(sums.dtype)[..., None], sums.shape)
    means = sums / lax.optimization_barrier(divisor)
    empty = sets.exists & (count == 0) & ~settled[:, None]
    turn = used[:, None] + jnp.cumsum(empty, axis=1, dtype=jnp.int32) - 1
    drawn = jnp.take_along_axis(sets.draws, jnp.maximum(turn, 0), axis=1)
    means = jnp.where(empty[..., None], _pick(sets.rows, drawn), means)
    return means, used + jnp.sum(empty, axis=1, dtype=jnp.int32)


def _squared_distances(sets: _Sets, centers: Float[Array, "N K D"]) -> Float[Array, "N K Q"]:
    form = "nkd,qd->nkq" if sets.rows.ndim == 2 else "nkd,nqd->nkq"
    product = jnp.einsum(form, centers, sets.rows, precision="highest")
    norms = sets.norms[None, None] if sets.rows.ndim == 2 else sets.norms[:, None]
    return norms - 2.0 * product + _square(centers)[..., None]


def _square(vectors: Float[Array, "... D"]) -> Float[Array, "..."]:
    return jnp.sum(vectors * vectors, axis=-1)


def _pick(rows: Array, index: Int[Array, "N K"]) -> Float[Array, "N K D"]:
    if rows.ndim == 2:
        return rows[index]
    return jnp.take_along_axis(rows, index[..., None], axis=1)


def _next_draw(sets: _Sets, used: Int[Array, "N"]) -> Int[Array, "N"]:
    return jnp.take_along_axis(sets.draws, used[:, None], axis=1)[:, 0]


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
    turn = jnp.arange(draws, dtype=jnp.int32)
    index = _locate(
        jnp.cumsum(accepted, axis=1, dtype=jnp.int32),
        jnp.broadcast_to(turn, (len(count), draws)),
    )
    return jnp.take_along_axis(upper, index, axis=1).astype(jnp.int32)


def _multiply(left: Array, right: Array) -> tuple[Array, Array]:
    """Upper and lower 32 bits of the product of 32-bit unsigned integers."""
    half = jnp.uint32(0xFFFF)
    left_low, left_high = left & half, left >> 16
    right_low, right_high = right & half, right >> 16
    cross = left_high * right_low + ((left_low * right_low) >> 16)
    other = left_low * right_high + (cross & half)
    return left_high * right_high + (cross >> 16) + (other >> 16), left * right


def _locate(rank: Int[Array, "N P"], number: Int[Array, "N T"]) -> Int[Array, "N T"]:
    """Position of the entry by its number among the marked ones; `rank` counts them up."""
    find = partial(jnp.searchsorted, side="left")
    position = jax.vmap(find)(rank, number + 1)
    return jnp.minimum(position, rank.shape[1] - 1).astype(jnp.int32)
