"""k-means over the patches of each detection (method.md#k-means).

Letters: `N` point sets (detections), `P` points (patches), `D` dimensions, `K` clusters.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from remind_jax.errors import ConfigError
from remind_jax.numerics.absent import NO_SLOT
from remind_jax.solvers.clustering_in_graph import cluster_in_graph


def kmeans(
    points: Float[Array, "P D"],
    members: Bool[Array, "N P"],
    wanted: Int[Array, "N"] | None = None,
    *,
    clusters: int,
    iterations: int,
    restarts: int,
    seed: int,
    solver: str,
) -> tuple[Int[Array, "N P"], Float[Array, "N K D"]]:
    """Clusters the member points of each set; the sets are independent.

    Initial centers are one drawn point and then the farthest ones; the restart of least inertia
    wins, the first among equals. Sets of fewer points than clusters get one cluster per point.

    Args:
      points: Points shared by all sets.
      wanted: Clusters of each set, from 1 to `clusters`; `clusters` if left out.
      iterations: Most rounds of one restart.
      seed: Seed of the draws, restarted for every set.
      solver: `"host"`: NumPy in one callback for all sets and batch entries; `"jax"`: the same
        procedure in the graph.

    Returns:
      Cluster of each point, -1 outside the set; centers, zero for clusters that do not exist.
      If a restart ends by its last round, centers are one update newer than labels.
    """
    if wanted is None:
        wanted = jnp.full(members.shape[0], clusters, jnp.int32)
    options = {"iterations": iterations, "restarts": restarts, "seed": seed}
    if solver == "jax":
        return cluster_in_graph(points, members, wanted, clusters=clusters, **options)
    if solver != "host":
        raise ConfigError(f"solver {solver!r} is unknown; use 'host' or 'jax'")

    def cluster_batched(points, members, wanted):
        points, members, wanted = map(np.asarray, (points, members, wanted))
        labels = np.full(members.shape, NO_SLOT, np.int8)
        centers = np.zeros((*wanted.shape, clusters, points.shape[-1]), points.dtype)
        for index in np.ndindex(*wanted.shape):
            inside = np.flatnonzero(members[index])
            if len(inside):
                labels[index][inside], found = cluster_points(
                    points[index[:-1]][inside], int(wanted[index]), **options
                )
                centers[index][: len(found)] = found
        return labels, centers

    shape = (members.shape[0], clusters, points.shape[1])
    out = (
        jax.ShapeDtypeStruct(members.shape, jnp.int8),
        jax.ShapeDtypeStruct(shape, points.dtype),
    )
    labels, centers = jax.pure_callback(
        cluster_batched, out, points, members, wanted, vmap_method="broadcast_all"
    )
    return labels.astype(jnp.int32), centers


def cluster_points(
    points: Float[np.ndarray, "P D"], clusters: int, iterations: int, restarts: int, seed: int
) -> tuple[Int[np.ndarray, "P"], Float[np.ndarray, "K D"]]:
    """NumPy form of `kmeans` for one set; also returns the centers, `K = min(clusters, P)`.

    The draws of all restarts come from one stream. If a restart ends by its last round, the
    centers are one update newer than the labels.
    """
    num = len(points)
    clusters = min(clusters, num)
    stream = np.random.Generator(np.random.PCG64(seed))
    norms = np.einsum("pd,pd->p", points, points)
    best = (np.zeros(num, np.int8), points[:1])
    least = np.inf
    for _ in range(restarts):
        centers = _spread_centers(points, norms, clusters, stream)
        labels, reached = np.full(num, NO_SLOT, np.int8), norms
        for _ in range(iterations):
            distance = _squared_distances(points, norms, centers)
            nearest = distance.argmin(axis=1).astype(np.int8)
            reached = distance[np.arange(num), nearest]
            settled = np.array_equal(nearest, labels)
            labels = nearest
            if settled:
                break
            counts = np.bincount(labels, minlength=clusters)
            onehot = (labels[None] == np.arange(clusters)[:, None]).astype(points.dtype)
            means = (onehot @ points) / np.maximum(counts, 1).astype(points.dtype)[:, None]
            for empty in np.flatnonzero(counts == 0):
                means[empty] = points[stream.integers(0, num)]
            centers = means
        inertia = reached.sum(dtype=np.float64)
        if inertia < least:
            least, best = inertia, (labels, centers)
    return best


def _spread_centers(points, norms, clusters, stream):
    """One drawn point, then always the point farthest from those chosen."""
    num = len(points)
    chosen = [int(stream.integers(0, num))]
    gap = _squared_distances(points, norms, points[chosen])[:, 0]
    for _ in range(1, clusters):
        chosen.append(int(gap.argmax()) if (gap > 0).any() else int(stream.integers(0, num)))
        gap = np.minimum(gap, _squared_distances(points, norms, points[chosen[-1:]])[:, 0])
    return points[chosen]


def _squared_distances(points, norms, centers):
    squares = np.einsum("kd,kd->k", centers, centers)
    return norms[:, None] - 2.0 * (points @ centers.T) + squares[None]
