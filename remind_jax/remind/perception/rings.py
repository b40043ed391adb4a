"""Background rings around an object (method.md#rings).

Letters: `N` detections, `Hp Wp` patch grid, `P = Hp * Wp`, `R = 2` rings (inner, outer).
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from remind_jax.remind.thresholds.perception import Perception

INNER, OUTER = 0, 1


def find_rings(
    object_patches: Bool[Array, "N Hp Wp"], max_radius: int, thresholds: Perception
) -> Bool[Array, "N R Hp Wp"]:
    """The inner and the outer ring of patches around each object, without its border; may be empty.

    A ring that holds too few patches (at the edge of the frame, between objects) grows outwards, to
    `max_radius` patches at most.
    """
    t = thresholds
    distance = _chebyshev_distance(object_patches, max_radius)
    radii = jnp.arange(max_radius + 1)
    within = jnp.sum(distance[:, None] <= radii[:, None, None], axis=(2, 3))

    def count(low: Int[Array, "..."], high: Int[Array, "..."]) -> Int[Array, "N"]:
        low, high = (jnp.broadcast_to(r, within.shape[:1]) for r in (low, high))
        take = lambda r: jnp.take_along_axis(within, r[:, None], axis=1)[:, 0]  # noqa: E731
        return jnp.maximum(take(high) - take(low), 0)

    def widen(start: Array, low: Array, minimum: Array) -> Int[Array, "N"]:
        """Grows the outer edge one patch at a time until the ring is full or at the limit."""

        def grow(_: Array, edge: Array) -> Array:
            short = (count(low, edge) < minimum) & (edge < limit) & t.ring_adaptive
            return jnp.where(short, edge + 1, edge)

        start = jnp.broadcast_to(start, within.shape[:1])
        return jax.lax.fori_loop(0, max_radius, grow, start)

    limit = jnp.minimum(jnp.maximum(t.ring_outer, t.ring_limit), max_radius)
    first = jnp.minimum(jnp.maximum(t.ring_inner, t.ring_border), max_radius)
    inner_edge = widen(first, t.ring_border, t.ring_min_inner)
    start = jnp.maximum(jnp.maximum(t.ring_outer, t.ring_inner), inner_edge)
    outer_from = jnp.where(t.ring_nested, t.ring_border, inner_edge)
    outer_edge = widen(jnp.minimum(start, max_radius), outer_from, t.ring_min_outer)

    def ring(low: Array, high: Array) -> Bool[Array, "N Hp Wp"]:
        low, high = (jnp.broadcast_to(r, within.shape[:1])[:, None, None] for r in (low, high))
        return (distance > low) & (distance <= high)

    rings = jnp.stack([ring(t.ring_border, inner_edge), ring(outer_from, outer_edge)], axis=1)
    return rings & t.rings_enabled


def _chebyshev_distance(
    object_patches: Bool[Array, "N Hp Wp"], max_radius: int
) -> Int[Array, "N Hp Wp"]:
    """Steps of a king from the object to each patch; `max_radius + 1` if farther."""

    def dilate(reached: Bool[Array, "N Hp Wp"]) -> Bool[Array, "N Hp Wp"]:
        padded = jnp.pad(reached, ((0, 0), (1, 1), (0, 0)))
        rows = padded[:, :-2] | padded[:, 1:-1] | padded[:, 2:]
        padded = jnp.pad(rows, ((0, 0), (0, 0), (1, 1)))
        return padded[:, :, :-2] | padded[:, :, 1:-1] | padded[:, :, 2:]

    def step(_: Array, carry: tuple[Array, Array]) -> tuple[Array, Array]:
        reached, distance = carry
        reached = dilate(reached)
        return reached, distance - reached.astype(jnp.int32)

    start = (object_patches, jnp.full(object_patches.shape, max_radius + 1, jnp.int32))
    reached, distance = jax.lax.fori_loop(0, max_radius, step, start)
    del reached
    return jnp.where(object_patches, 0, distance)


def ring_weights(
    rings: Bool[Array, "N R Hp Wp"], object_coverage: Float[Array, "N Hp Wp"]
) -> Float[Array, "N R P"]:
    """Weighs ring patches by the share that is background."""
    weights = jnp.where(rings, 1.0 - object_coverage[:, None], 0.0)
    return weights.reshape(*rings.shape[:2], -1)
