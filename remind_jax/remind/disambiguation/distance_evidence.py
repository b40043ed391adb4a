"""Remembered distances of chosen objects, and how far they can be relied on.

Letters: `O` object slots.
"""

from __future__ import annotations

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from remind_jax.numerics.pytree import pytree
from remind_jax.numerics.rounding import divide
from remind_jax.remind.memory.distances import DistanceGraph, Edges
from remind_jax.remind.thresholds.known_sets import KnownSets

FULL_RELIABILITY_EPISODES = 6  # method.md#distance-evidence
INFORMATIVENESS_SUPPORT = 0.80  # hard-coded in the original (method.md#distance-evidence)
INFORMATIVENESS_FLOOR = 0.10
AGREEMENT_BASE, AGREEMENT_CONTACT, AGREEMENT_SUPPORT = 0.5, 0.25, 0.25  # method.md#undecided-groups
TINY = 1e-12
_TINY_REF = 1e-6


@pytree
class KnownDistances:
    """Remembered distances of selected pairs of objects; the fields share one shape."""

    reliability: Float[Array, "..."]  # [0, 1]; 0: not seen together often enough
    has_gap: Bool[Array, "..."]
    distance: Float[Array, "..."]  # the gap if known, else the distance of the centers
    support: Float[Array, "..."]

    @property
    def usable(self) -> Bool[Array, "..."]:
        """Pairs with a distance that may be relied on."""
        return self.reliability > 0


@pytree
class PairOrders:
    """Remembered order of selected pairs of objects as seen from an anchor."""

    seen: Bool[Array, "..."]
    first: Float[Array, "..."]  # share of episodes with the lower slot nearer
    consistency: Float[Array, "..."]  # share of the usual order, [0.5, 1]
    margin: Float[Array, "..."]  # mean difference of the two distances
    robustness: Float[Array, "..."]  # [0, 1]


def rate_reliability(count: Int[Array, "..."], scalar: jnp.dtype) -> Float[Array, "..."]:
    """Trust in a statistic of `count` episodes, [0, 1] (method.md#distance-evidence)."""
    return jnp.minimum(1.0, jnp.sqrt(count.astype(scalar) / FULL_RELIABILITY_EPISODES))


def rate_difference(
    value: Float[Array, "..."], reference: Array | float, t: KnownSets
) -> Float[Array, "..."]:
    """How clear a difference of distances is, [0, 1) (method.md#voter-usefulness)."""
    scaled = divide(jnp.maximum(0.0, value), jnp.maximum(_TINY_REF, reference * t.strength_scale))
    return (1.0 - jnp.exp(-scaled)) ** t.strength_power


def tabulate_edges(edges: Edges, t: KnownSets) -> Float[Array, "O O 4"]:
    """All edges, the fields of `KnownDistances` side by side: `read_edges` is one gather."""
    scalar = edges.gap_mean.dtype
    reliability = rate_reliability(edges.count, scalar)
    reliability = jnp.where(reliability >= t.min_reliability, reliability, 0.0)
    has_gap = edges.gap_count > 0
    distance = jnp.where(has_gap, edges.gap_mean, edges.center_mean)
    columns = (reliability, has_gap.astype(scalar), distance, edges.support_mean)
    return jnp.stack(columns, axis=-1)


def read_edges(
    table: Float[Array, "O O 4"],
    source: Int[Array, "..."],
    target: Int[Array, "..."],
    known: Bool[Array, "..."],
) -> KnownDistances:
    """Distances remembered by objects `source` to objects `target` (slots that broadcast).

    `known` marks the pairs of objects in memory; the others get no edge.
    """
    row = jnp.where(known, source * table.shape[0] + target, 0)
    value = table.reshape(-1, table.shape[-1])[row]
    reliability = jnp.where(known, value[..., 0], 0.0)
    return KnownDistances(
        reliability=reliability,
        has_gap=(value[..., 1] > 0) & (reliability > 0),
        distance=value[..., 2],
        support=value[..., 3],
    )


def read_orders(
    graph: DistanceGraph,
    anchor: Int[Array, "..."],
    x: Int[Array, "..."],
    y: Int[Array, "..."],
    known: Bool[Array, "..."],
    t: KnownSets,
) -> PairOrders:
    """Order of objects `x` and `y` as seen from `anchor` (slots that broadcast).

    `known` marks the pairs of two objects in memory; the others were never seen.
    """
    scalar, size = graph.margin.dtype, graph.margin.shape[0]
    low, high = jnp.minimum(x, y), jnp.maximum(x, y)
    cell = jnp.where(known, (anchor * size + low) * size + high, 0)
    mirror = jnp.where(known, (anchor * size + high) * size + low, 0)
    first = graph.nearer.reshape(-1)[cell]
    count = jnp.where(known, first + graph.nearer.reshape(-1)[mirror], 0)
    seen = count > 0
    first = jnp.where(seen, first.astype(scalar), 0.0) / jnp.maximum(1, count).astype(scalar)
    consistency = jnp.maximum(first, 1.0 - first)
    margin = jnp.where(seen, graph.margin.reshape(-1)[cell], 0.0)
    squares = jnp.maximum(0.0, graph.margin.reshape(-1)[mirror])
    variance = squares / jnp.maximum(1, count - 1).astype(scalar)
    deviation = jnp.where(count > 1, jnp.sqrt(variance), 0.0)
    stable = margin / jnp.maximum(_TINY_REF, margin + deviation)
    trust = t.consistency_floor + (1.0 - t.consistency_floor) * consistency**t.consistency_power
    clear = (1.0 - t.margin_weight) * stable
    clear = clear + t.margin_weight * rate_difference(margin, t.margin_ref, t)
    return PairOrders(
        seen=seen,
        first=first,
        consistency=consistency,
        margin=margin,
        robustness=jnp.where(seen, trust * rate_reliability(count, scalar) * clear, 0.0),
    )
