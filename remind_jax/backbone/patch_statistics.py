"""The embedded default backbone: what color, gradients and texture say about a patch.

A pure function of the image without any weights. Each patch of 16 pixels is described by soft
histograms of five quantities, taken at half resolution. Light is divided out where it enters:

* hue and saturation: logarithms of color ratios, with the offset of the logarithm tied to the
  brightness around, so that a dimmer lamp or a shorter exposure moves almost nothing;
* chroma and luminance against the surrounding 7x7 patches, which cancels tinted and uneven light;
* texture: both opposite neighbors darker, alike or brighter, in units of the local contrast;
* chroma gradients on a logarithmic scale.

Hue and saturation enter at the scale of the patch, and everything at the scale of the 3x3 patches
around it. Nothing depends on the frame as a whole: a patch looks the same wherever it is seen.

In closeups it is known which patches an object covers: there the windows that describe it weigh
patches by that, and others, of all patches alike, describe its background.

Square roots of histograms make inner products into Hellinger affinities. The square root of a
typical histogram, a few simple laws written down below and no average over any recording, is
subtracted in part: what all objects share would otherwise lift every cosine towards one.

Weights and bin counts were chosen by rank-1 on development sequences, one setting for all of them;
none is delicate: `benchmarks/nearest_neighbor.py` changes by less than 0.05 on the mean when a
block is left out, halved or doubled. Beside a network: backbones.md#measured.
"""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, UInt8

from remind_jax.backbone import cell_histograms as cells
from remind_jax.backbone.registry import DEFAULT_BACKBONE, Backbone
from remind_jax.compiled.programs import keep_function
from remind_jax.numerics.control_flow import branch
from remind_jax.numerics.pooling import to_unit
from remind_jax.numerics.pytree import pytree

PATCH_PX = 2 * cells.CELL_PX  # cells lie on the image at half resolution

NUM_HUES, NUM_SATURATIONS = 16, 4
NUM_CHROMA, NUM_LUMINANCE, NUM_GRADIENT, NUM_CONTRAST = 5, 10, 8, 3
SATURATION_MAX = 2.2
RED_GREEN_MAX, BLUE_YELLOW_MAX, LUMINANCE_MAX = 0.3, 0.4, 1.0  # natural logarithms of ratios
GRADIENT_MIN, GRADIENT_MAX = 0.01, 0.4  # the same per pixel

SENSOR_OFFSET = 4.0  # gray levels; keeps noise in the dark from looking like color
LOCAL_OFFSET = 0.2  # of the brightness around
SURROUND_RADIUS = 3  # cells
NEIGHBOR_PX = 3  # at half resolution
DIRECTIONS = ((0, 1), (1, 1), (1, 0), (1, -1))  # down, right

# How much of what all scenes share is subtracted. It spreads cosines (towards 1: different objects
# near 0) and hardly changes which object is nearest.
CENTERING = 0.8

# Rows and columns of patches whose histograms are made together on a CPU, if one of them is wanted:
# few enough to stay in its cache.
TILE = (3, 9)


@dataclasses.dataclass(frozen=True)
class Block:
    """One histogram within the feature vector."""

    quantity: str  # key of `bins_of` and of `typical_histograms`
    window_radius: int  # cells, 0 or 1; 0: the patch alone
    weight: float
    # Length of the mean square-root histogram over patches of random scenes (overlapping colored
    # ellipses with grain): below one, as a patch fills few of the bins.
    common_length: float


HUE = Block("hue_saturation", 0, weight=1.4, common_length=0.4)
HUE_NEAR = Block("hue_saturation", 1, weight=1.4, common_length=0.5)
SURROUND = Block("surround_chroma", 1, weight=1.1, common_length=0.9)
TEXTURE = Block("texture", 1, weight=2.0, common_length=0.9)
LUMINANCE = Block("luminance", 1, weight=1.0, common_length=0.8)
GRADIENT = Block("chroma_gradient", 1, weight=0.8, common_length=0.9)

BLOCKS = (HUE, HUE_NEAR, SURROUND, TEXTURE, LUMINANCE, GRADIENT)
# In closeups.
OF_OBJECT = (HUE, SURROUND, TEXTURE, LUMINANCE, GRADIENT)
OF_BACKGROUND = (HUE_NEAR, TEXTURE, LUMINANCE)
BACKGROUND_WEIGHT = 0.7  # length of its features, beside those of the object
OUTSIDE_WEIGHT = 0.02  # of a patch that the object does not touch, beside one that it covers
LIGHT_CHANGES = Path(__file__).with_name("light_changes.npy")  # made by benchmarks/light_changes.py


@pytree
class PixelPlanes:
    """What histograms are made of, pixel by pixel at half resolution."""

    hue: Float[Array, "H W"]  # in turns
    saturation: Float[Array, "H W"]
    chroma_above: Float[Array, "2 H W"]  # the surroundings
    luminance_above: Float[Array, "H W"]
    contrast: Float[Array, "H W"]
    smooth: Float[Array, "3 _h _w"]  # luminance and chroma, `NEIGHBOR_PX` beyond each side


@functools.cache
def patch_statistics() -> Backbone:
    """Makes the weight-free backbone."""
    tile = TILE if jax.default_backend() == "cpu" else None

    def kept(name: str, one: Callable[..., Any]) -> Callable[..., Any]:
        def describe_each(each: tuple[Any, ...]) -> Any:
            given = functools.partial(one, *each, tile=tile)
            none = jax.eval_shape(given)
            wanted = each[1]
            return branch(jnp.any(wanted), given, lambda: jnp.zeros(none.shape, none.dtype))

        def describe(*arguments: Any) -> Any:
            return jax.lax.map(describe_each, arguments)

        return keep_function(name, describe, (CENTERING, tile))

    apply_to = kept(DEFAULT_BACKBONE, describe_patches)

    def apply(images: Any) -> Any:
        num, height, width = images.shape[:3]
        return apply_to(images, np.ones((num, height // PATCH_PX, width // PATCH_PX), bool))

    return Backbone(
        DEFAULT_BACKBONE,
        PATCH_PX,
        _num_features(BLOCKS),
        apply,
        apply_to=apply_to,
        apply_closeups=kept(f"{DEFAULT_BACKBONE}-closeups", describe_closeup),
        num_background=_num_features(OF_BACKGROUND),
        light_changes=np.load(LIGHT_CHANGES).astype(np.float32),
    )


def describe_patches(
    image: UInt8[Array, "H W 3"],
    wanted: Bool[Array, "Hp Wp"],
    *,
    tile: tuple[int, int] | None,
) -> Float[Array, "Hp Wp D"]:
    """Features of patches of one image whose sides are multiples of `PATCH_PX`.

    Those that are not `wanted` are zero; what else is wanted changes no patch.
    """
    histograms = measure_cells(image, _with_neighbors(wanted), tile)
    features = _side_by_side(BLOCKS, histograms, cells.window_mean(histograms, 1))
    return jnp.where(wanted[..., None], features, 0.0)


def describe_closeup(
    image: UInt8[Array, "S S 3"],
    wanted: Bool[Array, "V V"],
    coverage: Float[Array, "V V"],
    *,
    tile: tuple[int, int] | None,
) -> Float[Array, "V V D"]:
    """Features of patches of one closeup: those of its object, then those of its background.

    As `describe_patches`; the object covers a share `coverage` of each patch, [0, 1].
    """
    histograms = measure_cells(image, _with_neighbors(wanted), tile)
    weight = coverage + OUTSIDE_WEIGHT
    of_object = cells.window_mean(histograms * weight, 1) / cells.window_mean(weight, 1)
    features = jnp.concatenate(
        [
            to_unit(_side_by_side(OF_OBJECT, histograms, of_object)),
            BACKGROUND_WEIGHT
            * to_unit(_side_by_side(OF_BACKGROUND, histograms, cells.window_mean(histograms, 1))),
        ],
        axis=-1,
    )
    return jnp.where(wanted[..., None], features, 0.0)


def _with_neighbors(wanted: Bool[Array, "Hp Wp"]) -> Bool[Array, "Hp Wp"]:
    """Patches whose histograms are needed: a patch needs those of its neighbors."""
    return jax.lax.reduce_window(wanted, False, jax.lax.bitwise_or, (3, 3), (1, 1), "SAME")


def _side_by_side(
    blocks: Sequence[Block],
    histograms: Float[Array, "K Hp Wp"],
    near: Float[Array, "K Hp Wp"],
) -> Float[Array, "Hp Wp D"]:
    """Square roots of histograms of patches, or of their windows (`near`), less what is typical."""
    roots = []
    for block in blocks:
        pooled = (near if block.window_radius else histograms)[bins_of()[block.quantity]]
        typical = np.sqrt(typical_histograms()[block.quantity])
        common = np.float32(CENTERING * block.common_length) * typical
        roots.append(block.weight * (jnp.sqrt(pooled) - common[:, None, None]))
    return jnp.moveaxis(jnp.concatenate(roots), 0, -1)


def _num_features(blocks: Sequence[Block]) -> int:
    return sum(len(typical_histograms()[block.quantity]) for block in blocks)


def measure_cells(
    image: UInt8[Array, "H W 3"], needed: Bool[Array, "Hp Wp"], tile: tuple[int, int] | None = None
) -> Float[Array, "K Hp Wp"]:
    """Histograms of the five quantities (`bins_of`) over each needed patch, each summing to one."""
    height, width = (
        min(most, side) for most, side in zip(tile or needed.shape, needed.shape, strict=True)
    )
    return cells.measure_tiles(_histograms, _pixel_planes(image), needed, (height, width))


@functools.cache
def bins_of() -> dict[str, slice]:
    """Where each quantity lies among all histograms."""
    sizes = [len(histogram) for histogram in typical_histograms().values()]
    ends = np.cumsum(sizes).tolist()
    places = (slice(end - size, end) for size, end in zip(sizes, ends, strict=True))
    return dict(zip(typical_histograms(), places, strict=True))


def _pixel_planes(image: UInt8[Array, "H W 3"]) -> PixelPlanes:
    color = cells.halve(image)
    gray = jnp.asarray(sum(color)) / len(color)
    around = cells.spread(cells.window_mean(cells.cell_mean(gray), 1))
    red, green, blue = jnp.log(color + SENSOR_OFFSET + LOCAL_OFFSET * around)
    chroma = jnp.stack([red - green, blue - (red + green) / 2])
    luminance = jnp.log(gray + SENSOR_OFFSET)
    smoothed = cells.smooth(jnp.stack([luminance, *chroma]), sigma_px=1.5, reach_px=4)
    variance = cells.cell_mean((smoothed[0] - cells.spread(cells.cell_mean(smoothed[0]))) ** 2)
    margin = (NEIGHBOR_PX, NEIGHBOR_PX)
    return PixelPlanes(
        hue=cells.angle(chroma[1], chroma[0]),
        saturation=jnp.log1p(8 * jnp.sqrt(jnp.sum(chroma**2, axis=0))),
        chroma_above=cells.above_surround(chroma, SURROUND_RADIUS),
        luminance_above=cells.above_surround(luminance, SURROUND_RADIUS),
        contrast=cells.spread(jnp.sqrt(cells.window_mean(variance, 1) + 0.02**2)),
        smooth=jnp.pad(smoothed, ((0, 0), margin, margin), "edge"),
    )


def _histograms(planes: PixelPlanes) -> Float[Array, "K h w"]:
    """Those of all quantities over the patches of a tile."""
    red_green, blue_yellow = planes.chroma_above
    histograms = {
        "hue_saturation": _hue_saturation_histogram(planes.hue, planes.saturation),
        "surround_chroma": cells.joint_histogram(
            cells.soft_bins(red_green, -RED_GREEN_MAX, RED_GREEN_MAX, NUM_CHROMA),
            cells.soft_bins(blue_yellow, -BLUE_YELLOW_MAX, BLUE_YELLOW_MAX, NUM_CHROMA),
        ),
        "texture": _texture_histogram(planes.smooth[0], planes.contrast),
        "luminance": cells.cell_mean(
            cells.soft_bins(planes.luminance_above, -LUMINANCE_MAX, LUMINANCE_MAX, NUM_LUMINANCE)
        ),
        "chroma_gradient": _gradient_histogram(planes.smooth[1:]),
    }
    return jnp.concatenate([histograms[quantity] for quantity in bins_of()])


def _hue_saturation_histogram(
    hue: Float[Array, "H W"], saturation: Float[Array, "H W"]
) -> Float[Array, "K Hp Wp"]:
    """Hue by saturation; the least saturated bin has no hue, for the hue of gray is noise."""
    shares = cells.soft_bins(saturation, 0.0, SATURATION_MAX, NUM_SATURATIONS)
    colored = cells.joint_histogram(cells.soft_bins_periodic(hue, NUM_HUES), shares[1:])
    return jnp.concatenate([cells.cell_mean(shares[:1]), colored])


def _texture_histogram(
    luminance: Float[Array, "_h _w"], contrast: Float[Array, "H W"]
) -> Float[Array, "K Hp Wp"]:
    """Soft ternary patterns of opposite neighbors in four directions, by local contrast."""
    there = [(down * NEIGHBOR_PX, right * NEIGHBOR_PX) for down, right in DIRECTIONS]
    opposite = [(-down, -right) for down, right in there]
    here, *around = cells.shifts(luminance, NEIGHBOR_PX, [(0, 0), *there, *opposite])
    sides = [jnp.tanh((side - here) / (0.4 * contrast)) for side in around]
    shares = cells.soft_bins(jnp.stack(sides), -1.0, 1.0, NUM_CONTRAST)
    patterns = cells.joint_histogram(shares[: len(there)], shares[len(there) :])
    return patterns.reshape(-1, *patterns.shape[2:]) / len(DIRECTIONS)


def _gradient_histogram(chroma: Float[Array, "2 _h _w"]) -> Float[Array, "K Hp Wp"]:
    """Logarithms of the length of the chroma gradient."""
    steps = ((0, 1), (0, -1), (1, 0), (-1, 0))
    right, left, below, above = cells.shifts(chroma, NEIGHBOR_PX, steps)
    length = jnp.sqrt(sum((right - left) ** 2 + (below - above) ** 2)) / 2
    low, high = math.log(GRADIENT_MIN), math.log(GRADIENT_MAX)
    logarithm = jnp.log(length + GRADIENT_MIN)
    return cells.cell_mean(cells.soft_bins(logarithm, low, high, NUM_GRADIENT))


@functools.cache
def typical_histograms() -> dict[str, Float[np.ndarray, "K"]]:
    """What a patch of an unknown scene may be expected to hold, quantity by quantity.

    Contrasts fall off exponentially, hues are equally frequent, edges and ridges of all directions
    are as common as each other and evenness twice as common.
    """

    def decay(highest: float, num: int, scale: float) -> np.ndarray:
        return np.exp(-np.abs(np.linspace(-highest, highest, num)) / scale)

    saturations = np.exp(-np.linspace(0.0, SATURATION_MAX, NUM_SATURATIONS) / 0.5)
    colored = np.tile(saturations[1:] / NUM_HUES, NUM_HUES)
    patterns = np.ones((NUM_CONTRAST, NUM_CONTRAST))
    patterns[1, 1] = 2.0
    gradients = np.linspace(np.log(GRADIENT_MIN), np.log(GRADIENT_MAX), NUM_GRADIENT)
    counts = {
        "hue_saturation": np.append(saturations[:1], colored),
        "surround_chroma": np.outer(
            decay(RED_GREEN_MAX, NUM_CHROMA, 0.08), decay(BLUE_YELLOW_MAX, NUM_CHROMA, 0.12)
        ).ravel(),
        "texture": np.tile(patterns.ravel(), len(DIRECTIONS)),
        "luminance": decay(LUMINANCE_MAX, NUM_LUMINANCE, 0.35),
        "chroma_gradient": np.exp(-0.5 * ((gradients - np.log(0.03)) / 0.8) ** 2),
    }
    return {name: (count / count.sum()).astype(np.float32) for name, count in counts.items()}
