"""What enters one step of the tracker on the device.

Letters: `N` detection slots, `Hp Wp` patch grid, `P = Hp * Wp` patches in raster order, `D`
feature dimension.
"""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING, Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from remind_jax.numerics.pytree import pytree

if TYPE_CHECKING:
    AnyArray = Any  # what may be done with it depends on where it comes from
else:
    AnyArray = jax.Array | np.ndarray  # from the host, or traced


@pytree
class PatchAttention:
    """How patches of objects attend to each other, averaged over layers and heads.

    Letters: `Q` patches that belong to any object of the frame. Rows are not rescaled: what a patch
    pays to other tokens than patches is missing in its sum.
    """

    patches: Int[AnyArray, "Q"]  # ascending raster numbers; -1 in unused slots, whose rest is zero
    row_sums: Float[AnyArray, "Q"]  # of each, over all patches of the frame
    block: Float[AnyArray, "Q Q"]  # from row to column


@pytree
class FrameFeats:
    """What a backbone says about one frame."""

    patches: Float[AnyArray, "Hp Wp D"]  # raw patch features, not normalized
    frame_size: Int[AnyArray, "2"]  # height and width in pixels
    attention: PatchAttention | None = None  # only for static.part_source "attention" or "both"


@pytree
class CloseupFeats:
    """What a backbone says about each detection in a picture of its own (`masks.closeups`).

    Letters: `V` patches along a side of such a picture. Slots without a mask are zero.
    """

    patches: Float[AnyArray, "N V V D"]  # raw patch features, not normalized
    coverage: Float[AnyArray, "N V V"]  # share of each patch inside the mask, [0, 1]
    is_background: Bool[AnyArray, "D"]  # channels that tell of the background
    light_changes: Float[AnyArray, "G D"]  # main directions of change by the color of light
    frame_size: Int[AnyArray, "2"]  # height and width in pixels


AnyFeats = FrameFeats | CloseupFeats


@pytree
class MaskRelations:
    """What relations need of pixel masks, reduced on the host; padding slots are zero."""

    # Between masks where exact, else boxes; negative: overlap. None where a method reads no gap.
    gap_px: Float[AnyArray, "N N"] | None
    exact: Bool[AnyArray, "N N"] | None  # the gap was measured between the masks
    touches_border: Bool[AnyArray, "N"]  # the mask reaches the edge of the frame


@pytree
class Masks:
    """What the tracker needs of the pixel masks of one frame, reduced on the host.

    Padding slots are zero with `valid` false. Detection order is slot order.
    """

    coverage: Float[AnyArray, "N Hp Wp"]  # share of each patch inside the mask, [0, 1]
    filled_coverage: Float[AnyArray, "N Hp Wp"]  # the same for the sanitized (convex) mask
    quality: Float[AnyArray, "N"]  # mask area / sanitized area, [0, 1]
    box: Float[AnyArray, "N 4"]  # left, top, right, bottom in pixels, right and bottom excluded
    center: Float[AnyArray, "N 2"]  # mean x, mean y of the mask pixels (pixel indices)
    area: Float[AnyArray, "N"]  # pixels
    class_id: Int[AnyArray, "N"]  # index into the class vocabulary
    detector_score: Float[AnyArray, "N"]  # [0, 1]
    relations: MaskRelations  # between every two of them
    valid: Bool[AnyArray, "N"]


def without_coverage(masks: Masks) -> Masks:
    """Masks for what reads no patches: the largest of their arrays are left empty."""
    nothing = jnp.zeros((len(masks.valid), 0, 0), jnp.float32)
    return dataclasses.replace(masks, coverage=nothing, filled_coverage=nothing)


def coverage_of(frame_feats: AnyFeats, masks: Masks) -> Float[AnyArray, "N Hp Wp"]:
    """Share of each patch that features tell of inside each mask, [0, 1]."""
    return frame_feats.coverage if isinstance(frame_feats, CloseupFeats) else masks.coverage


def background_channels(frame_feats: AnyFeats) -> Bool[AnyArray, "D"]:
    """Channels that tell of the background of a detection, and not of the detection."""
    if isinstance(frame_feats, CloseupFeats):
        return frame_feats.is_background
    return np.zeros(frame_feats.patches.shape[-1], bool)


def light_changes(frame_feats: AnyFeats) -> Float[AnyArray, "G D"]:
    """Main directions in which looks change with the color of light; none where not known."""
    if isinstance(frame_feats, CloseupFeats):
        return frame_feats.light_changes
    return np.zeros((0, frame_feats.patches.shape[-1]), np.float32)


@pytree
class RingPatches:
    """Patches that are typical of the background rings, the most important first.

    Letters: `R` rings (inner, outer), `M` prototypes of a ring.
    """

    vector: Float[Array, "N R M D"]  # unit length where valid, else zero
    valid: Bool[Array, "N R M"]


@pytree
class Descriptors:
    """What each detection of a frame looks like (method.md#described-frame).

    Letters: `A` appearance channels (global, trimmed), `C` part channels (clusters, attention),
    `K` parts, `R` rings (inner, outer). Vectors have unit length where valid, else are zero.
    """

    appearance: Float[Array, "N A D"]
    appearance_valid: Bool[Array, "N A"]
    parts: Float[Array, "N C K D"]  # by falling support
    parts_valid: Bool[Array, "N C K"]
    rings: Float[Array, "N R D"]
    rings_valid: Bool[Array, "N R"]
    num_patches: Int[Array, "N"]  # patches of the object, capped
    patch_sum: Float[Array, "N"]  # summed coverage in patches ("effective patches")
    num_parts: Int[Array, "N"]  # largest over part channels
    part_support: Float[Array, "N"]  # summed coverage of the parts, largest over part channels
    ring_patches: Int[Array, "N R"]
    mask_quality: Float[Array, "N"]  # solidity of the mask, (0, 1]
    class_id: Int[AnyArray, "N"]
    valid: Bool[AnyArray, "N"]  # a detection with a mask and finite features
    num_bad_patches: Int[Array, ""]  # patches of the frame that are not usable
    ring_prototypes: RingPatches | None = None  # only with static.ring_prototypes
