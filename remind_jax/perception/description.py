"""What does each detection look like? From patch features and masks (paper III-B)."""

from __future__ import annotations

import jax.numpy as jnp

from remind_jax.config.static import Static
from remind_jax.config.thresholds import Thresholds
from remind_jax.observation import Descriptors, FrameFeats, Masks
from remind_jax.perception.parts import cluster_parts
from remind_jax.perception.pooling import keep_typical, pool, to_unit
from remind_jax.perception.ring_prototypes import find_ring_prototypes
from remind_jax.perception.rings import find_rings, ring_weights


def describe(
    frame_feats: FrameFeats, masks: Masks, static: Static, thresholds: Thresholds
) -> Descriptors:
    """Describes every detection by its appearance, its parts and its background.

    Patches with a feature that is not finite are left out everywhere; a detection that loses all
    its patches is not valid. One that never covered a patch is, without any descriptor
    (perception notes 7).
    """
    t = thresholds.perception
    num = masks.valid.shape[0]
    finite = jnp.all(jnp.isfinite(frame_feats.patches), axis=-1)
    features = jnp.where(finite[..., None], frame_feats.patches, 0.0)
    features = features.reshape(-1, features.shape[-1]).astype(jnp.float32)

    given = jnp.where(masks.valid[:, None, None], masks.coverage, 0.0)
    filled = jnp.where(masks.valid[:, None, None], masks.filled_coverage, 0.0)
    coverage = jnp.where(finite, given, 0.0)
    selected = coverage > t.patch_coverage.astype(coverage.dtype)
    weights = jnp.where(selected, coverage, 0.0).reshape(num, -1)
    members = selected.reshape(num, -1)

    mean, present = pool(weights, features)
    typical = keep_typical(features, mean, members, t.trim_keep, t.trim_min_patches)
    trimmed, _ = pool(jnp.where(typical, weights, 0.0), features)
    parts, parts_valid, support = cluster_parts(features, weights, members, static, t)

    # An object that sanitising left as it was keeps its own selection of patches.
    unchanged = jnp.all(filled == given, axis=(1, 2), keepdims=True)
    blocked = jnp.where(
        unchanged,
        given > t.patch_coverage.astype(given.dtype),
        filled > t.ring_object_coverage.astype(filled.dtype),
    )
    rings = find_rings(blocked, static.ring_max_radius, t) & finite
    background = ring_weights(rings, filled)
    ring_mean, ring_present = pool(background, features)
    prototypes = None
    if static.ring_prototypes:
        inside = rings.reshape(background.shape)
        prototypes = find_ring_prototypes(
            features, inside, background, static, thresholds.ring_prototypes
        )

    covered, lost = jnp.any(given > 0, axis=(1, 2)), ~jnp.any(coverage > 0, axis=(1, 2))
    return Descriptors(
        appearance=to_unit(jnp.stack([mean, trimmed], axis=1)),
        appearance_valid=jnp.stack([present, present], axis=1),
        parts=parts[:, None],
        parts_valid=parts_valid[:, None],
        rings=to_unit(ring_mean),
        rings_valid=ring_present,
        num_patches=jnp.minimum(jnp.sum(members, axis=-1), t.max_counted_patches),
        patch_sum=jnp.sum(coverage, axis=(1, 2)).astype(static.scalar),
        num_parts=jnp.sum(parts_valid, axis=-1),
        part_support=jnp.sum(support, axis=-1).astype(static.scalar),
        ring_patches=jnp.sum(rings, axis=(2, 3)),
        mask_quality=jnp.where(masks.quality > 0, masks.quality, 1.0).astype(static.scalar),
        class_id=masks.class_id,
        valid=masks.valid & ~(covered & lost),
        num_bad_patches=jnp.sum(~finite, dtype=jnp.int32),
        ring_prototypes=prototypes,
    )
