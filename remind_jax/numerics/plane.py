"""Points, vectors and sizes in the image plane, coordinate by coordinate.

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


def middle_of(box: Float[Array, "N 4"]) -> Float[Array, "N 2"]:
    """Middles of boxes."""
    return (box[:, :2] + box[:, 2:]) / 2


def area_of(box: Float[Array, "*any 4"]) -> Float[Array, "*any"]:
    """Areas of boxes, 0 of what is none."""
    extent = jnp.maximum(box[..., 2:] - box[..., :2], 0.0)
    return extent[..., 0] * extent[..., 1]


def common_box(
    left: Float[Array, "*left 4"], right: Float[Array, "*right 4"]
) -> Float[Array, "*both 4"]:
    """What two boxes share; its corners change sides if they are apart."""
    low = jnp.maximum(left[..., :2], right[..., :2])
    return jnp.concatenate([low, jnp.minimum(left[..., 2:], right[..., 2:])], axis=-1)


def overlap_of(left: Float[Array, "N 4"], right: Float[Array, "M 4"]) -> Float[Array, "N M"]:
    """Intersection over union of every two boxes."""
    inner = area_of(common_box(left[:, None], right))
    return inner / jnp.maximum(area_of(left)[:, None] + area_of(right) - inner, 1e-6)


def mean_sizes(left: Float[Array, "N"], right: Float[Array, "M"]) -> Float[Array, "N M"]:
    """Geometric mean of every two sizes; a root per size, not per pair."""
    return jnp.sqrt(left)[:, None] * jnp.sqrt(right)[None]


def log_ratios(left: Float[Array, "N"], right: Float[Array, "M"]) -> Float[Array, "N M"]:
    """Logarithm of the first size by the second, of every two; one per size, not per pair."""
    return jnp.log(left)[:, None] - jnp.log(right)[None]


def medians(values: Float[Array, "K N"], counted: Bool[Array, "N"]) -> Float[Array, "K"]:
    """Median of some of the values of each row, 0 of none."""
    ordered = jnp.sort(jnp.where(counted, values, jnp.inf), axis=1)
    num = jnp.sum(counted)
    low, high = jnp.maximum(num - 1, 0) // 2, num // 2
    middle = (ordered[:, low] + ordered[:, jnp.minimum(high, len(counted) - 1)]) / 2
    return jnp.where(num > 0, middle, 0.0)
