"""How the detections of one frame lie to each other (paper III-D; method.md#relations).

Lengths are normalized by the mean side of the two masks. Letters: `N` detections.
"""

from __future__ import annotations

import enum

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from remind_jax.numerics.pytree import pytree
from remind_jax.observation import Masks
from remind_jax.remind.thresholds.relations import Relations as Rules

_TINY = 1e-6
_SUPPORT_MAX_RATIO = 0.6  # a thing that rests on another is smaller than it by this factor
_SUPPORT_INSIDE = 0.75
_SUPPORT_OVERLAP, _SUPPORT_MIN_OVERLAP = 0.60, 0.5


class Contact(enum.IntEnum):
    """How close two masks are; of equally frequent ones the larger code counts."""

    NEAR = 0
    OVERLAP = 1
    SEPARATE = 2
    TOUCH = 3


@pytree
class Relations:
    """Every pair of detections; symmetric. The diagonal and padding are invalid."""

    gap: Float[Array, "N N"]  # between the masks, normalized; negative where they overlap
    center_distance: Float[Array, "N N"]  # between the mask centers, normalized
    contact: Int[Array, "N N"]  # Contact
    support: Float[Array, "N N"]  # how far one seems to rest on or in the other, [0, 1]
    gap_valid: Bool[Array, "N N"]  # the gap can be trusted
    gap_quality: Float[Array, "N N"]  # [0, 1]
    truncated: Bool[Array, "N N"]  # one of the two is cut by the edge of the frame
    valid: Bool[Array, "N N"]  # two different detections

    @property
    def distance(self) -> Float[Array, "N N"]:
        """The gap where it can be trusted, else the distance of the centers."""
        return jnp.where(self.gap_valid, self.gap, self.center_distance)


def observe_relations(masks: Masks, t: Rules) -> Relations:
    """Relates every two detections of a frame.

    A close pair without an exact gap is judged by its boxes, at lower quality.
    """
    scalar, mask_relations = t.scale_min_px.dtype, masks.relations
    box, center = jnp.asarray(masks.box, scalar), jnp.asarray(masks.center, scalar)
    area = jnp.asarray(masks.area, scalar)
    side = jnp.sqrt(area)
    scale = jnp.maximum(t.scale_min_px, 0.5 * (side[:, None] + side[None]))
    scale = jnp.maximum(_TINY, scale)
    box_gap_px, box_overlap = relate_boxes(box)

    far = (box_gap_px > 0) & (box_gap_px / scale > t.exact_gap_max)
    assert mask_relations.gap_px is not None  # as `gap_options` says
    assert mask_relations.exact is not None
    trusted = mask_relations.exact | far
    gap_px = jnp.where(
        mask_relations.exact & ~far, jnp.asarray(mask_relations.gap_px, scalar), box_gap_px
    )
    border = jnp.asarray(mask_relations.touches_border)
    truncated = border[:, None] | border[None]
    quality = jnp.where(trusted, 1.0, jnp.where(truncated, 0.0, 0.5)).astype(scalar)
    contact = _contact(gap_px, gap_px / scale, t)
    across, down = jnp.moveaxis(center[:, None] - center[None], -1, 0)
    apart = jnp.sqrt(across**2 + down**2)
    valid = masks.valid[:, None] & masks.valid[None] & ~jnp.eye(area.shape[0], dtype=bool)
    return Relations(
        gap=gap_px / scale,
        center_distance=apart / scale,
        contact=contact,
        support=_support(area, box, center, box_overlap, contact),
        gap_valid=quality > 0,
        gap_quality=quality,
        truncated=truncated,
        valid=valid,
    )


def relate_boxes(box: Float[Array, "N 4"]) -> tuple[Float[Array, "N N"], Float[Array, "N N"]]:
    """Gap of every two boxes in pixels, negative where they overlap, and their common area."""
    low, high = box[:, :2], box[:, 2:]
    apart = jnp.maximum(0.0, jnp.maximum(low[:, None] - high[None], low[None] - high[:, None]))
    common = jnp.minimum(high[:, None], high[None]) - jnp.maximum(low[:, None], low[None])
    across, down = jnp.moveaxis(apart, -1, 0)
    width, height = jnp.moveaxis(jnp.maximum(0.0, common), -1, 0)
    area = width * height
    is_apart = (across > 0) | (down > 0)
    return jnp.where(is_apart, jnp.sqrt(across**2 + down**2), -jnp.sqrt(area)), area


def _contact(gap_px: Float[Array, "N N"], gap: Float[Array, "N N"], t: Rules) -> Int[Array, "N N"]:
    contact = jnp.where(gap <= t.near, Contact.NEAR, Contact.SEPARATE)
    contact = jnp.where(gap_px <= t.contact_margin_px, Contact.TOUCH, contact)
    return jnp.where(gap_px < 0, Contact.OVERLAP, contact).astype(jnp.int32)


def _support(
    area: Float[Array, "N"],
    box: Float[Array, "N 4"],
    center: Float[Array, "N 2"],
    box_overlap: Float[Array, "N N"],
    contact: Int[Array, "N N"],
) -> Float[Array, "N N"]:
    """Containment of the smaller thing by the larger, 0 for things of like size."""
    small = jnp.maximum(_TINY, jnp.minimum(area[:, None], area[None]))
    large = jnp.maximum(_TINY, jnp.maximum(area[:, None], area[None]))
    overlap = box_overlap / small
    inside = (center[:, None] >= box[None, :, :2]) & (center[:, None] <= box[None, :, 2:])
    in_box = inside[..., 0] & inside[..., 1]
    close = contact != Contact.SEPARATE
    support = jnp.maximum(overlap, jnp.where((in_box | in_box.T) & close, _SUPPORT_INSIDE, 0.0))
    rests = (overlap >= _SUPPORT_MIN_OVERLAP) & close
    support = jnp.maximum(support, jnp.where(rests, _SUPPORT_OVERLAP, 0.0))
    return jnp.where(small / large <= _SUPPORT_MAX_RATIO, jnp.clip(support, 0.0, 1.0), 0.0)
