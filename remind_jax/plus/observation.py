"""What REMIND plus looks at in a frame: pooled looks, backgrounds, boxes, and the image motion.

Letters: `N` detection slots, `P` patches, `D` feature dimension. Lengths are in frame units
(`thresholds.FRAME_AREA`).
"""

from __future__ import annotations

import dataclasses

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from remind_jax.observation import AnyArray, FrameFeats, Masks
from remind_jax.perception.pooling import pool, to_unit
from remind_jax.plus.thresholds import FRAME_AREA

RING_PATCHES = 2  # the background is looked at this far around an object


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Motion:
    """Where points of the frame before lie in this one."""

    matrix: Float[AnyArray, "2 3"]  # similarity, pixels to pixels
    score: Float[AnyArray, ""]  # trust, [0, 1]; 0: unknown


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Sightings:
    """The detections of one frame."""

    look: Float[Array, "N D"]  # mean feature of the object
    ring: Float[Array, "N D"]  # mean feature of the background around it
    has_ring: Bool[Array, "N"]
    box: Float[Array, "N 4"]  # left, top, right, bottom
    center: Float[Array, "N 2"]  # of the mask
    size: Float[Array, "N"]  # square root of the area of the mask
    patches: Float[Array, "N"]  # the same in sides of a patch
    class_id: Int[Array, "N"]
    touches: Bool[Array, "N"]  # the border of the frame
    valid: Bool[Array, "N"]
    frame_center: Float[Array, "2"]
    num_bad_patches: Int[Array, ""]  # with a feature that is not finite; they are left out


def frame_unit(frame_size: Int[AnyArray, "2"]) -> Float[Array, ""]:
    """Length of a frame unit in pixels."""
    height, width = (jnp.asarray(side, jnp.float32) for side in (frame_size[0], frame_size[1]))
    return jnp.sqrt(height * width / FRAME_AREA)


def observe(frame_feats: FrameFeats, masks: Masks, unit_patches: Bool[Array, ""]) -> Sightings:
    """Pools the features of a frame over its masks (notes of REMIND plus, 3).

    Args:
      frame_feats: Patch features; `frame_size` is that of the pixels of `masks`.
      masks: Detections.
      unit_patches: Scale every patch feature to unit length first.
    """
    rows, columns, dim = frame_feats.patches.shape
    features = jnp.asarray(frame_feats.patches, jnp.float32).reshape(-1, dim)
    finite = jnp.all(jnp.isfinite(features), axis=-1)
    features = jnp.where(finite[:, None], features, 0.0)
    features = jnp.where(unit_patches, to_unit(features), features)

    coverage = jnp.asarray(masks.coverage, jnp.float32)
    reach = 2 * RING_PATCHES + 1
    near = lax.reduce_window(
        coverage, -jnp.inf, lax.max, (1, reach, reach), (1, 1, 1), "SAME"
    )  # fmt: skip
    inside = coverage.reshape(-1, rows * columns)
    around = jnp.where(near.reshape(inside.shape) > 0, 1.0 - inside, 0.0)
    look, is_seen = pool(inside * inside * finite, features)
    ring, has_ring = pool(around * finite, features)

    unit = frame_unit(frame_feats.frame_size)
    size_px = jnp.sqrt(jnp.asarray(masks.area, jnp.float32))
    height, width = frame_feats.frame_size[0], frame_feats.frame_size[1]
    patch_px = jnp.sqrt(jnp.asarray(height * width, jnp.float32) / (rows * columns))
    valid = jnp.asarray(masks.valid) & is_seen
    return Sightings(
        look=look,
        ring=ring,
        has_ring=has_ring & valid,
        box=jnp.asarray(masks.box, jnp.float32) / unit,
        center=jnp.asarray(masks.center, jnp.float32) / unit,
        size=jnp.maximum(size_px, 1.0) / unit,
        patches=size_px / patch_px,
        class_id=jnp.asarray(masks.class_id, jnp.int32),
        touches=jnp.asarray(masks.relations.touches_border),
        valid=valid,
        frame_center=jnp.stack([jnp.asarray(width), jnp.asarray(height)]).astype(jnp.float32)
        / (2 * unit),
        num_bad_patches=jnp.sum(~finite, dtype=jnp.int32),
    )


def in_frame_units(motion: Motion, unit: Float[Array, ""]) -> Motion:
    """The same motion between points in frame units."""
    matrix = jnp.asarray(motion.matrix, jnp.float32)
    matrix = jnp.concatenate([matrix[:, :2], matrix[:, 2:] / unit], axis=1)
    return Motion(matrix, jnp.asarray(motion.score, jnp.float32))
