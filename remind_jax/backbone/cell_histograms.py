"""Soft histograms of image channels over the square cells of a grid.

Letters: `C` channels, `K L` bins, `H W` pixels, `Hc Wc` cells of `CELL_PX` pixels. Channels and
bins come first, so that the long pixel axes are the contiguous ones. The histogram of a cell is
the mean of its pixels' bin shares.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, UInt8

CELL_PX = 8

# Of arctan(s) / (2 pi s) in s^2, highest power first: least largest error for s in [0, 1], 6e-9.
_ARCTAN = (
    -0.00064530409, 0.0034795974, -0.0088987241, 0.015346036,
    -0.022136273, 0.031745946, -0.053046121, 0.15915484,
)  # fmt: skip


def halve(image: UInt8[Array, "H W C"]) -> Float[Array, "C H/2 W/2"]:
    """Means of 2x2 pixels: half the size and half the noise."""
    height, width, num = image.shape
    # Along the rows first: pixels of a row lie side by side.
    rows = image.astype(jnp.uint16).reshape(height // 2, 2, width * num)
    pairs = (rows[:, 0] + rows[:, 1]).reshape(height // 2, width // 2, 2 * num)
    total = pairs[..., :num] + pairs[..., num:]
    return jnp.moveaxis(total, -1, 0).astype(jnp.float32) / 4


def cell_mean(values: Float[Array, "*C H W"]) -> Float[Array, "*C Hc Wc"]:
    """Mean over each cell."""
    *leading, height, width = values.shape
    # A sum written out, then a product: of sums over such axes the compiler makes no vector
    # instructions.
    pixels = values.reshape(*leading, height // CELL_PX, CELL_PX, width)
    rows = jnp.asarray(sum(pixels[..., i, :] for i in range(CELL_PX)))
    share = np.repeat(np.eye(width // CELL_PX, dtype=np.float32), CELL_PX, axis=0) / CELL_PX**2
    return jnp.matmul(rows, share, precision="highest")


def window_mean(cells: Float[Array, "*C Hc Wc"], radius: int) -> Float[Array, "*C Hc Wc"]:
    """Mean over `2 radius + 1` cells in both directions; cells outside the image are left out."""
    height, width = cells.shape[-2:]
    places = list(itertools.product(range(2 * radius + 1), repeat=2))

    def window_sum(of: Array) -> Array:
        margins = ((0, 0),) * (of.ndim - 2) + ((radius, radius),) * 2
        padded = jnp.pad(of, margins)
        # Written out, like the sums of cells.
        parts = (padded[..., top : top + height, left : left + width] for top, left in places)
        return jnp.asarray(sum(parts))

    return window_sum(cells) / window_sum(jnp.ones((height, width), cells.dtype))


def spread(cells: Float[Array, "*C Hc Wc"]) -> Float[Array, "*C H W"]:
    """Gives every pixel the value of its cell."""
    return jnp.repeat(jnp.repeat(cells, CELL_PX, -2), CELL_PX, -1)


def above_surround(values: Float[Array, "*C H W"], radius: int) -> Float[Array, "*C H W"]:
    """Pixels minus the mean of the window of cells around theirs."""
    return values - spread(window_mean(cell_mean(values), radius))


def shifts(
    padded: Float[Array, "*C _h _w"], margin_px: int, steps_px: Sequence[tuple[int, int]]
) -> list[Float[Array, "*C H W"]]:
    """What lies each step `(down, right)` away, of values with a margin that no step exceeds."""
    height, width = (side - 2 * margin_px for side in padded.shape[-2:])
    return [
        padded[..., top : top + height, left : left + width]
        for top, left in ((margin_px + down, margin_px + right) for down, right in steps_px)
    ]


def measure_tiles(
    measure: Callable[[Any], Float[Array, "K _h _w"]],
    planes: Any,
    needed: Bool[Array, "Hc Wc"],
    tile: tuple[int, int],
) -> Float[Array, "K Hc Wc"]:
    """Measures the tiles of the frame that hold a needed cell; the cells of others are zero.

    A cell gets the same values, to the bit, whatever else is needed.
    """
    height, width = tile
    rows, columns = needed.shape
    below, right = -rows % height, -columns % width  # what the last tiles reach beyond the frame

    if below or right:
        # Of their last pixels: what is no number in a tile would reach all of it.
        beyond = ((0, CELL_PX * below), (0, CELL_PX * right))
        planes = jax.tree.map(
            lambda plane: jnp.pad(plane, ((0, 0),) * (plane.ndim - 2) + beyond, "edge"), planes
        )
        needed = jnp.pad(needed, ((0, below), (0, right)))
    down, across = needed.shape[0] // height, needed.shape[1] // width
    is_needed = jnp.any(needed.reshape(down, height, across, width), axis=(1, 3)).ravel()
    numbers = jnp.argsort(~is_needed, stable=True)  # those that are needed first

    def cut(number: Array) -> Any:
        top, left = number // across * height * CELL_PX, number % across * width * CELL_PX

        def of_plane(plane: Array) -> Array:
            margins = plane.shape[-1] - CELL_PX * needed.shape[1]
            size = (CELL_PX * height + margins, CELL_PX * width + margins)
            start = (0,) * (plane.ndim - 2) + (top, left)
            return jax.lax.dynamic_slice(plane, start, (*plane.shape[:-2], *size))

        return jax.tree.map(of_plane, planes)

    def add(turn: Array, cells: Array) -> Array:
        number = numbers[turn]
        start = (0, number // across * height, number % across * width)
        return jax.lax.dynamic_update_slice(cells, measure(cut(number)), start)

    num_bins = jax.eval_shape(lambda: measure(cut(numbers[0]))).shape[0]
    cells = jnp.zeros((num_bins, *needed.shape), jnp.float32)
    cells = jax.lax.fori_loop(0, jnp.sum(is_needed), add, cells)
    return cells[:, :rows, :columns]


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
        values = jnp.asarray(sum(tap * part for tap, part in zip(taps, parts, strict=True)))
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


def angle(y: Float[Array, "*S"], x: Float[Array, "*S"]) -> Float[Array, "*S"]:
    """Angles of points in whole turns, [-0.5, 0.5], to 1e-7; 0 at the origin.

    Several times as fast as `arctan2`, of which the compiler makes no vector instructions.
    """
    high, low = jnp.maximum(jnp.abs(x), jnp.abs(y)), jnp.minimum(jnp.abs(x), jnp.abs(y))
    slope = low / jnp.where(high > 0, high, 1.0)
    coefficients = jnp.asarray(_ARCTAN, slope.dtype)
    turns = slope * jnp.polyval(coefficients, slope * slope, unroll=len(_ARCTAN))
    turns = jnp.where(jnp.abs(y) > jnp.abs(x), 0.25 - turns, turns)
    turns = jnp.where(x < 0, 0.5 - turns, turns)
    return jnp.where(y < 0, -turns, turns)


def joint_histogram(
    first: Float[Array, "*C K H W"], second: Float[Array, "*C L H W"]
) -> Float[Array, "*C K*L Hc Wc"]:
    """Mean shares of each cell by pairs of bins; the second bin changes fastest."""
    pairs = first[..., :, None, :, :] * second[..., None, :, :, :]
    *leading, num_first, num_second, height, width = pairs.shape
    return cell_mean(pairs.reshape(*leading, num_first * num_second, height, width))


def _bin_index(num: int) -> Float[Array, "K 1 1"]:
    return jnp.arange(num, dtype=jnp.float32)[:, None, None]
