"""How a vision transformer knows where a patch is: rotary tables and resampled position tables."""

from __future__ import annotations

import functools
from typing import Literal

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from remind_jax.backbone.vit_variants import ROTARY_BASE

Resampling = Literal["offset", "size", "antialias"]

OFFSET = 0.1  # patches; DINO and DINOv2 without registers add it to the grid before dividing
_CUBIC, _CUBIC_ANTIALIAS = -0.75, -0.5  # slope of the cubic at one sample's distance


def rotary_periods(head_width: int) -> Float[np.ndarray, "K"]:
    """Periods as published: a quarter of the head width many, from 1 to below 100."""
    exponents = np.arange(head_width // 4) * 4.0 / head_width
    return np.power(ROTARY_BASE, exponents).astype(np.float32)


def rotary_tables(
    rows: int, columns: int, periods: Float[Array, "K"]
) -> tuple[Float[Array, "P 4*K"], Float[Array, "P 4*K"]]:
    """Sine and cosine that rotate the patches of a grid, in raster order.

    Angles are `2 pi coordinate / period` of the patch center; both axes run inside (-1, 1). A row
    holds vertical angles, then horizontal ones, then both again (backbones.md#rotary-positions).
    """
    y = 2 * ((np.arange(rows, dtype=np.float32) + 0.5) / rows) - 1
    x = 2 * ((np.arange(columns, dtype=np.float32) + 0.5) / columns) - 1
    centers = np.stack(np.meshgrid(y, x, indexing="ij"), axis=-1).reshape(-1, 2, 1)
    angles = np.float32(2 * np.pi) * centers.astype(np.float32) / periods.astype(jnp.float32)
    angles = jnp.tile(angles.reshape(rows * columns, -1), (1, 2))
    return jnp.sin(angles), jnp.cos(angles)


def rotate(
    tokens: Float[Array, "... P E"], sine: Float[Array, "P E"], cosine: Float[Array, "P E"]
) -> Float[Array, "... P E"]:
    """Turns every feature together with the one half a head away."""
    first, second = jnp.split(tokens, 2, axis=-1)
    return tokens * cosine + jnp.concatenate([-second, first], axis=-1) * sine


def resample_table(
    table: Float[Array, "M M D"], rows: int, columns: int, rule: Resampling
) -> Float[Array, "rows columns D"]:
    """Brings a square position table to a patch grid.

    As published, the table is taken as it is only where the grid is square and of the same size.
    """
    side = table.shape[0]
    if rows == columns == side:
        return table
    down = resampling_matrix(rows, side, rule)
    across = resampling_matrix(columns, side, rule)
    return jnp.einsum("hi,wj,ijd->hwd", down, across, table, precision=jax.lax.Precision.HIGHEST)


@functools.lru_cache(maxsize=64)
def resampling_matrix(num_out: int, num_in: int, rule: Resampling) -> Float[np.ndarray, "O I"]:
    """Weights of every sample of one axis at every new position (backbones.md#position-tables).

    Coordinates are rounded to float32 once, as the reference's fused operations do; all else is in
    float64.
    """
    if rule == "antialias":
        return _antialias_matrix(num_out, num_in)
    step = np.float32(num_in) / np.float32(num_out)
    if rule == "offset":
        step = np.float32(1.0 / ((num_out + OFFSET) / num_in))
    where = np.float32(np.float64(step) * (np.arange(num_out) + 0.5) - 0.5).astype(np.float64)
    first = np.floor(where).astype(int) - 1
    matrix = np.zeros((num_out, num_in))
    for tap in range(4):
        weight = _cubic(where - (first + tap), _CUBIC)
        sample = np.clip(first + tap, 0, num_in - 1)  # beyond the border lies the border
        np.add.at(matrix, (np.arange(num_out), sample), weight)
    return matrix.astype(np.float32)


def _antialias_matrix(num_out: int, num_in: int) -> Float[np.ndarray, "O I"]:
    """A wider cubic where the grid is coarser than the table; cut off and rescaled at borders."""
    scale = np.float32(num_in) / np.float32(num_out)
    support = 2.0 * max(float(scale), 1.0)
    inverse = np.float32(1.0 / max(float(scale), 1.0))
    matrix = np.zeros((num_out, num_in))
    for i in range(num_out):
        center = np.float32(scale * np.float32(i + 0.5))
        low = max(int(center - support + 0.5), 0)
        high = min(int(center + support + 0.5), num_in)
        distance = np.float32((np.arange(low, high) - np.float64(center) + 0.5) * inverse)
        weight = _cubic(np.asarray(distance, np.float64), _CUBIC_ANTIALIAS)
        matrix[i, low:high] = weight / weight.sum()
    return matrix.astype(np.float32)


def _cubic(distance: np.ndarray, slope: float) -> np.ndarray:
    """Keys' cubic convolution kernel."""
    s = np.abs(distance)
    near = ((slope + 2) * s - (slope + 3)) * s * s + 1
    far = slope * (((s - 5) * s + 8) * s - 4)
    return np.where(s <= 1, near, np.where(s < 2, far, 0.0))
