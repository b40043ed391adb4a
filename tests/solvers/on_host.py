"""The solvers in plain NumPy and SciPy, with which those in the graph are compared."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy import optimize

from remind_jax.numerics.absent import NO_SLOT
from remind_jax.solvers.assignment_in_graph import FORBIDDEN_COST


def assign_groups(
    scores: Float[np.ndarray, "N M"],
    allowed: Bool[np.ndarray, "N M"],
    group: Int[np.ndarray, "N"],
    dummy: Float[np.ndarray, "N"],
    dummies: bool,
    present: Bool[np.ndarray, "N M"] | None = None,
) -> Int[np.ndarray, "N"]:
    """What `assign_in_graph` gives, by one call of SciPy for each group."""
    column = np.full(len(group), NO_SLOT, np.int32)
    active = allowed.any(axis=1)
    # A row without any allowed pair still takes a dummy in the original; as each row has its own
    # dummy at the same price for all, leaving it out changes nothing with dummies. Without them it
    # would only take a forbidden cell, which is rejected afterwards.
    for label in np.unique(group[active]):
        rows = (
            np.flatnonzero(group == label)
            if not dummies
            else np.flatnonzero((group == label) & active)
        )
        columns = np.flatnonzero((allowed if present is None else present)[rows].any(axis=0))
        cost = np.where(
            allowed[np.ix_(rows, columns)],
            -scores[np.ix_(rows, columns)].astype(np.float64),
            FORBIDDEN_COST,
        )
        if dummies:
            price = np.repeat(-dummy[rows, None].astype(np.float64), len(rows), axis=1)
            cost = np.concatenate([cost, price], axis=1)
        chosen_rows, chosen = optimize.linear_sum_assignment(cost)
        real = chosen < len(columns)
        picked_rows, picked = rows[chosen_rows[real]], columns[chosen[real]]
        fits = allowed[picked_rows, picked]
        column[picked_rows[fits]] = picked[fits]
    return column


def cluster_points(
    points: Float[np.ndarray, "P D"], clusters: int, iterations: int, restarts: int, seed: int
) -> tuple[Int[np.ndarray, "P"], Float[np.ndarray, "K D"]]:
    """What `cluster_in_graph` gives for one set, whose points are all members."""
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


def cluster_sets(points, members, wanted, *, clusters, iterations, restarts, seed):
    """What `cluster_in_graph` gives: labels and centers of all sets."""
    labels = np.full(members.shape, NO_SLOT, np.int32)
    centers = np.zeros((len(members), clusters, points.shape[1]), points.dtype)
    for row, member in enumerate(members):
        if member.any():
            labels[row, member], found = cluster_points(
                points[member], int(wanted[row]), iterations, restarts, seed
            )
            centers[row, : len(found)] = found
    return labels, centers
