"""What does each detection look like? From patch features and masks (paper III-B)."""

from __future__ import annotations

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from remind_jax.errors import ConfigError
from remind_jax.numerics.pooling import are_usable, keep_typical, pool
from remind_jax.numerics.pytree import pytree
from remind_jax.numerics.reductions import reduce_together
from remind_jax.numerics.rounding import unit
from remind_jax.observation import Descriptors, FrameFeats, Masks, PatchAttention
from remind_jax.remind.perception.parts import Parts, cluster_parts, find_attention_parts
from remind_jax.remind.perception.ring_prototypes import find_ring_prototypes
from remind_jax.remind.perception.rings import find_rings, ring_weights
from remind_jax.remind.thresholds import Thresholds
from remind_jax.remind.thresholds.perception import Perception
from remind_jax.static import Static


@pytree
class DescribedFrame:
    """What a decision is given of a frame."""

    descriptors: Descriptors
    masks: Masks  # without patch coverage, which nothing reads after the description


def describe(
    frame_feats: FrameFeats, masks: Masks, static: Static, thresholds: Thresholds
) -> Descriptors:
    """Describes every detection (method.md#patch-coverage, method.md#object-descriptors).

    Patches that are not usable (`are_usable`) are left out everywhere; a detection that loses all
    its patches is not valid. One that never covered a patch is, without any descriptor
    (method.md#described-frame).
    """
    t = thresholds.perception
    num = masks.valid.shape[0]
    usable = are_usable(frame_feats.patches)
    features = jnp.where(usable[..., None], frame_feats.patches, 0.0)
    features = features.reshape(-1, features.shape[-1]).astype(jnp.float32)

    given = jnp.where(masks.valid[:, None, None], masks.coverage, 0.0)
    filled = jnp.where(masks.valid[:, None, None], masks.filled_coverage, 0.0)
    coverage = jnp.where(usable, given, 0.0)
    selected = coverage > t.patch_coverage.astype(coverage.dtype)
    weights = jnp.where(selected, coverage, 0.0).reshape(num, -1)
    members = selected.reshape(num, -1)

    (whole, seen), (trimmed, seen_trimmed) = _describe_objects(
        features, weights, members, static, t
    )
    parts, parts_valid, support = _describe_parts(
        frame_feats.attention, features, weights, members, static, thresholds
    )
    kept = {"kmeans": t.kmeans_parts_kept, "attention": t.attention_parts_kept}
    parts_kept = jnp.stack([kept[channel] for channel in static.switches.part_channels])[:, None]

    # An object that sanitizing left as it was keeps its own selection of patches.
    unchanged, covered, left, patch_sum, num_patches = reduce_together(
        ("all", (filled == given).reshape(num, -1)),
        ("any", (given > 0).reshape(num, -1)),
        ("any", (coverage > 0).reshape(num, -1)),
        ("sum", coverage.reshape(num, -1)),
        ("sum", members),
        axis=1,
    )
    blocked = jnp.where(
        unchanged[:, None, None],
        given > t.patch_coverage.astype(given.dtype),
        filled > t.ring_object_coverage.astype(filled.dtype),
    )
    rings = find_rings(blocked, static.switches.ring_max_radius, t) & usable
    background = ring_weights(rings, filled)
    ring_mean, ring_present = pool(background, features)
    prototypes = None
    if static.switches.ring_prototypes:
        inside = rings.reshape(background.shape)
        prototypes = find_ring_prototypes(
            features, inside, background, static, thresholds.ring_prototypes
        )

    num_parts, part_support = reduce_together(("sum", parts_valid), ("sum", support), axis=2)
    return Descriptors(
        appearance=unit(jnp.stack([whole, trimmed], axis=1)),
        appearance_valid=jnp.stack([seen, seen_trimmed], axis=1),
        parts=parts,
        parts_valid=parts_valid & parts_kept,
        rings=unit(ring_mean),
        rings_valid=ring_present,
        num_patches=jnp.where(t.count_patches, jnp.minimum(num_patches, t.max_counted_patches), 0),
        patch_sum=patch_sum.astype(static.scalar),
        num_parts=jnp.max(num_parts, axis=1),
        part_support=jnp.max(part_support, axis=1).astype(static.scalar),
        ring_patches=jnp.sum(rings, axis=(2, 3)),
        mask_quality=jnp.where(masks.quality > 0, masks.quality, 1.0).astype(static.scalar),
        class_id=masks.class_id,
        valid=masks.valid & ~(covered & ~left),
        num_bad_patches=jnp.sum(~usable, dtype=jnp.int32),
        ring_prototypes=prototypes,
    )


def _describe_objects(
    features: Float[Array, "P D"],
    coverage: Float[Array, "N P"],
    members: Bool[Array, "N P"],
    static: Static,
    t: Perception,
) -> tuple[tuple[Array, Array], tuple[Array, Array]]:
    """Mean feature of all patches and of the typical ones, `[N, D]`, with their presence."""
    plain = members.astype(coverage.dtype)
    weights = coverage if static.switches.global_weighted else plain
    whole, seen = mean, present = pool(weights, features)
    if static.switches.trimmed_weighted != static.switches.global_weighted:
        weights = coverage if static.switches.trimmed_weighted else plain
        mean, present = pool(weights, features)
    typical = keep_typical(features, mean, members, t.trim_keep, t.trim_min_patches)
    trimmed, left = pool(jnp.where(typical, weights, 0.0), features)
    return (whole, seen & t.global_enabled), (trimmed, present & left & t.trimmed_enabled)


def _describe_parts(
    attention: PatchAttention | None,
    features: Float[Array, "P D"],
    coverage: Float[Array, "N P"],
    members: Bool[Array, "N P"],
    static: Static,
    thresholds: Thresholds,
) -> Parts:
    """Parts of all channels `[N C K ...]`, padded to the channel that may have most."""
    t, found = thresholds.perception, list[Parts]()
    for source in static.switches.part_channels:
        if source == "kmeans":
            found.append(cluster_parts(features, coverage, members, static, t))
            continue
        if attention is None:
            raise ConfigError(
                f"static.switches.part_source is {static.switches.part_source!r}, but the frame "
                "comes without attention; give it with the features or choose 'kmeans'"
            )
        found.append(
            find_attention_parts(
                features, coverage, members & t.parts_enabled, attention, static,
                thresholds.attention_parts,
            )
        )  # fmt: skip
    most = max(parts.exists.shape[1] for parts in found)

    def join(*leaves: Array) -> Array:
        """Side by side; the axis of the parts is the second."""
        kept = [(0, 0)] * (leaves[0].ndim - 2)
        padded = [jnp.pad(one, [(0, 0), (0, most - one.shape[1]), *kept]) for one in leaves]
        return jnp.stack(padded, axis=1)

    return jax.tree.map(join, *found)
