"""Soft histograms of image channels over the square cells of a grid.

Letters: `C` channels, `K L` bins, `H W` pixels, `Hc Wc` cells of `CELL_PX` pixels. Channels and
bins come first, so that the long pixel axes are the contiguous ones. The histogram of a cell is
the mean of its pixels' bin shares.
"""

from __future__ import annotations

from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

CELL_PX = 8


def halve(channels: Float[Array, "C H W"]) -> Float[Array, "C H/2 W/2"]:
    """Means of 2x2 pixels: half the size and half the noise."""
    num, height, width = channels.shape
    return channels.reshape(num, height // 2, 2, width // 2, 2).mean((2, 4))


def cell_mean(values: Float[Array, "*C H W"]) -> Float[Array, "*C Hc Wc"]:
    """Mean over each cell."""
    return _split(values).mean((-3, -1))


def window_mean(cells: Float[Array, "*C Hc Wc"], radius: int) -> Float[Array, "*C Hc Wc"]:
    """Mean over `2 radius + 1` cells in both directions; cells outside the image are left out."""
    window = (1,) * (cells.ndim - 2) + (2 * radius + 1,) * 2
    ones = jnp.ones_like(cells, shape=cells.shape[-2:])
    total = jax.lax.reduce_window(cells, 0.0, jax.lax.add, window, (1,) * cells.ndim, "SAME")
    count = jax.lax.reduce_window(ones, 0.0, jax.lax.add, window[-2:], (1, 1), "SAME")
    return total / count


def spread(cells: Float[Array, "*C Hc Wc"]) -> Float[Array, "*C H W"]:
    """Gives every pixel the value of its cell."""
    return jnp.repeat(jnp.repeat(cells, CELL_PX, -2), CELL_PX, -1)


def above_surround(values: Float[Array, "*C H W"], radius: int) -> Float[Array, "*C H W"]:
    """Pixels minus the mean of the window of cells around theirs."""
    return values - spread(window_mean(cell_mean(values), radius))


def shifts(
    values: Float[Array, "*C H W"], steps_px: Sequence[tuple[int, int]]
) -> Float[Array, "S *C H W"]:
    """What lies each step `(down, right)` away; border pixels repeat outside the image."""
    height, width = values.shape[-2:]
    reach = max(abs(component) for step in steps_px for component in step)
    padding = [(0, 0)] * (values.ndim - 2) + [(reach, reach)] * 2
    padded = jnp.pad(values, padding, mode="edge")
    return jnp.stack(
        [
            padded[..., reach + down : reach + down + height, reach + right : reach + right + width]
            for down, right in steps_px
        ]
    )


def smooth(
    values: Float[Array, "*C H W"], sigma_px: float, reach_px: int
) -> Float[Array, "*C H W"]:
    """Gaussian blur, cut off at `reach_px` so that nothing further away has any influence."""
    taps = np.exp(-0.5 * (np.arange(-reach_px, reach_px + 1) / sigma_px) ** 2)
    taps = [float(tap) for tap in taps / taps.sum()]
    for axis in (values.ndim - 2, values.ndim - 1):
        length = values.shape[axis]
        padding = [(reach_px, reach_px) if i == axis else (0, 0) for i in range(values.ndim)]
        padded = jnp.pad(values, padding, mode="edge")
        parts = [jax.lax.slice_in_dim(padded, i, i + length, axis=axis) for i in range(len(taps))]
        values = sum((tap * part for tap, part in zip(taps, parts, strict=True)), 0.0 * values)
    return values


def soft_bins(
    values: Float[Array, "*C H W"], low: float, high: float, num: int
) -> Float[Array, "*C K H W"]:
    """Shares of `num` bins, centerd from `low` to `high`, linear between neighboring centers.

    They sum to one at every pixel; values beyond an end belong to its bin.
    """
    position = (jnp.clip(values, low, high) - low) * ((num - 1) / (high - low))
    return jax.nn.relu(1 - jnp.abs(position[..., None, :, :] - _bin_index(num)))


def soft_bins_periodic(turns: Float[Array, "*C H W"], num: int) -> Float[Array, "*C K H W"]:
    """Shares of `num` bins around the circle; `turns` are angles in whole turns."""
    offset = turns[..., None, :, :] - _bin_index(num) / num
    return jax.nn.relu(1 - num * jnp.abs(offset - jnp.round(offset)))


def joint_histogram(
    first: Float[Array, "*C K H W"], second: Float[Array, "*C L H W"]
) -> Float[Array, "*C K*L Hc Wc"]:
    """Mean shares of each cell by pairs of bins; the second bin changes fastest."""
    pairs = jnp.einsum(
        "...khiwj,...lhiwj->...klhw", _split(first), _split(second), precision="highest"
    )
    *leading, num_first, num_second, rows, cols = pairs.shape
    return pairs.reshape(*leading, num_first * num_second, rows, cols) / CELL_PX**2


def _split(values: Float[Array, "*C H W"]) -> Float[Array, "*C Hc i Wc j"]:
    *leading, height, width = values.shape
    return values.reshape(*leading, height // CELL_PX, CELL_PX, width // CELL_PX, CELL_PX)


def _bin_index(num: int) -> Float[Array, "K 1 1"]:
    return jnp.arange(num, dtype=jnp.float32)[:, None, None]
