"""Points and vectors of the image plane, coordinate by coordinate.

Two coordinates are too few for a reduction or a matrix product, which would be steps of their own
in a compiled program.
"""

from __future__ import annotations

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float


def squared_length(vector: Float[Array, "*any 2"]) -> Float[Array, "*any"]:
    """Squared length of vectors."""
    return vector[..., 0] ** 2 + vector[..., 1] ** 2


def turned(points: Float[Array, "*any 2"], turn: Float[Array, "2 2"]) -> Float[Array, "*any 2"]:
    """Points after a linear map."""
    return points[..., :1] * turn[:, 0] + points[..., 1:] * turn[:, 1]


def zoom_of(turn: Float[Array, "2 2"]) -> Float[Array, ""]:
    """How much larger a linear map makes lengths."""
    area = turn[0, 0] * turn[1, 1] - turn[0, 1] * turn[1, 0]
    return jnp.sqrt(jnp.maximum(jnp.abs(area), 1e-6))


def lies_between(
    point: Float[Array, "*any 2"], low: Float[Array, "*#any 2"], high: Float[Array, "*#any 2"]
) -> Bool[Array, "*any"]:
    """Points inside boxes."""
    inside = (point > low) & (point < high)
    return inside[..., 0] & inside[..., 1]


def area_of(extent: Float[Array, "*any 2"]) -> Float[Array, "*any"]:
    """Areas of rectangles by width and height."""
    return extent[..., 0] * extent[..., 1]
