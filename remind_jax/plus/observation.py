"""What REMIND plus looks at in a frame: pooled looks, backgrounds, boxes, and the image motion.

Letters: `N` detection slots, `P` patches, `D` feature dimension. Lengths are in frame units
(`thresholds.FRAME_AREA`).
"""

from __future__ import annotations

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from remind_jax.numerics.pooling import are_usable, pool_patches, to_unit
from remind_jax.numerics.pytree import pytree
from remind_jax.observation import (
    AnyArray,
    AnyFeats,
    Masks,
    background_channels,
    coverage_of,
    light_changes,
)
from remind_jax.plus.thresholds import FRAME_AREA

RING_PATCHES = 2  # the background is looked at this far around an object


@pytree
class Motion:
    """Where points of the frame before lie in this one."""

    matrix: Float[AnyArray, "2 3"]  # similarity, pixels to pixels
    score: Float[AnyArray, ""]  # trust, [0, 1]; 0: unknown
    frame_size: Int[AnyArray, "2"]  # height and width of the image in pixels; 0: not known
    elapsed: Float[AnyArray, ""]  # ticks since the frame before


@pytree
class Sightings:
    """The detections of one frame."""

    look: Float[Array, "N D"]  # mean feature of the object, in some channels of its background
    is_background: Bool[Array, "D"]  # channels of the look that tell of the background
    light_changes: Float[Array, "G D"]  # main directions of change of looks by the color of light
    ring: Float[Array, "N D"]  # mean feature of the background around it
    has_ring: Bool[Array, "N"]
    box: Float[Array, "N 4"]  # left, top, right, bottom
    center: Float[Array, "N 2"]  # of the mask
    size: Float[Array, "N"]  # square root of the area of the mask
    class_id: Int[Array, "N"]
    touches: Bool[Array, "N"]  # the border of the frame
    valid: Bool[Array, "N"]
    frame_center: Float[Array, "2"]
    num_bad_patches: Int[Array, ""]  # not usable; they are left out


def observe(
    frame_feats: AnyFeats,
    masks: Masks,
    motion: Motion,
    unit_patches: Bool[Array, ""],
) -> tuple[Sightings, Motion]:
    """Pools features over masks and brings all lengths to frame units.

    Args:
      motion: Image motion in pixels of the masks.
      unit_patches: Scale every patch feature to unit length first.

    Returns:
      Detections (method_plus.md#sightings) and motion.
    """
    features = jnp.asarray(frame_feats.patches, jnp.float32)
    usable = are_usable(features)
    features = jnp.where(usable[..., None], features, 0.0)
    features = jnp.where(unit_patches, to_unit(features), features)

    inside = jnp.asarray(coverage_of(frame_feats, masks), jnp.float32)
    reach = 2 * RING_PATCHES + 1
    near = lax.reduce_window(inside, -jnp.inf, lax.max, (1, reach, reach), (1, 1, 1), "SAME")
    around = jnp.where(near > 0, 1.0 - inside, 0.0)
    look, is_seen = pool_patches(inside * inside * usable, features)
    ring, has_ring = pool_patches(around * usable, features)
    is_background = jnp.asarray(background_channels(frame_feats))
    look = jnp.where(is_background, ring, look)
    ring = jnp.where(is_background | ~jnp.any(is_background), ring, 0.0)

    # The tracker may work at a smaller size than that of the frame; the motion was measured there.
    known = jnp.all(jnp.asarray(motion.frame_size) > 0)
    size = jnp.where(known, motion.frame_size, frame_feats.frame_size).astype(jnp.float32)
    unit = jnp.sqrt(jnp.maximum(size[0] * size[1], 1.0) / FRAME_AREA)  # also of no frame at all
    size_px = jnp.sqrt(jnp.asarray(masks.area, jnp.float32))
    valid = jnp.asarray(masks.valid) & is_seen
    sightings = Sightings(
        look=look,
        is_background=is_background,
        light_changes=jnp.asarray(light_changes(frame_feats), jnp.float32),
        ring=ring,
        has_ring=has_ring & valid,
        box=jnp.asarray(masks.box, jnp.float32) / unit,
        center=jnp.asarray(masks.center, jnp.float32) / unit,
        size=jnp.maximum(size_px, 1.0) / unit,
        class_id=jnp.asarray(masks.class_id, jnp.int32),
        touches=jnp.asarray(masks.relations.touches_border),
        valid=valid,
        frame_center=size[::-1] / (2 * unit),
        num_bad_patches=jnp.sum(~usable, dtype=jnp.int32),
    )
    matrix = jnp.asarray(motion.matrix, jnp.float32)
    matrix = jnp.where(jnp.any(matrix[:, :2] != 0), matrix, jnp.eye(2, 3))  # of zeros: unknown
    matrix = jnp.concatenate([matrix[:, :2], matrix[:, 2:] / unit], axis=1)
    score, elapsed = (jnp.asarray(leaf, jnp.float32) for leaf in (motion.score, motion.elapsed))
    return sightings, Motion(matrix, score, motion.frame_size, elapsed)
