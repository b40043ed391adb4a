"""REMIND plus under its name among the trackers (`remind_jax.method`)."""

from __future__ import annotations

import jax.numpy as jnp
from jaxtyping import Array, Bool, Int

from remind_jax.method import Host, Method, Needs, Sweeping
from remind_jax.numerics.pytree import pytree
from remind_jax.observation import AnyFeats, Masks
from remind_jax.plus.earlier_files import COLUMNS, GONE_LEAVES, LENGTHENED, NEW_LEAVES
from remind_jax.plus.faults import find_faults
from remind_jax.plus.forgetting import coming_ids, remove_objects
from remind_jax.plus.image_light import ImageLight
from remind_jax.plus.image_motion import observe_motion
from remind_jax.plus.joining import join
from remind_jax.plus.observation import RING_PATCHES, Motion, Sightings, observe
from remind_jax.plus.recall import ObjectsAtRest
from remind_jax.plus.revision import DelayedAnswers, evidence, find_merges
from remind_jax.plus.state import PlusState, init
from remind_jax.plus.static import count_bytes
from remind_jax.plus.thresholds import PlusThresholds
from remind_jax.plus.tracker import advance
from remind_jax.plus.verdicts import Verdicts
from remind_jax.static import Static


@pytree
class SeenFrame:
    """What `tracker.advance` is given."""

    sightings: Sightings
    motion: Motion
    present: Bool[Array, "N"]  # slots that hold a mask


def describe_frame(
    frame_feats: AnyFeats,
    masks: Masks,
    observed: Motion,
    *,
    static: Static,
    thresholds: PlusThresholds,
) -> SeenFrame:
    """Pools looks and brings lengths to frame units."""
    unit_patches = thresholds.as_arrays().looks.unit_patches
    return SeenFrame(*observe(frame_feats, masks, observed, unit_patches), jnp.asarray(masks.valid))


def decide(
    state: PlusState, seen: SeenFrame, *, static: Static, thresholds: PlusThresholds
) -> tuple[PlusState, Verdicts]:
    """Decides who is who and remembers it."""
    return advance(
        state, seen.sightings, seen.motion, seen.present, static=static, thresholds=thresholds
    )


def count_occupied(state: PlusState) -> tuple[Int[Array, ""], int]:
    """Slots of objects, and those that open tracklets may need."""
    return jnp.sum(state.objects.exists) + jnp.sum(state.tracklets.is_open), 0


METHOD = Method(
    "plus",
    PlusThresholds,
    init,
    decide,
    describe_frame,
    Needs(
        observe=observe_motion,
        steady_light=ImageLight,
        patch_reach=RING_PATCHES,
        reads_closeups=True,
        prefers_closeups=True,
    ),
    Host(
        occupied=count_occupied,
        explainer_name="remind_jax.explanation.plus:PlusExplainer",
        merges=find_merges,
        delayed=DelayedAnswers,
        evidence=evidence,
        remove=remove_objects,
        coming_ids=coming_ids,
        find_faults=find_faults,
        columns=COLUMNS,
        new_leaves=NEW_LEAVES,
        gone_leaves=GONE_LEAVES,
        lengthened=LENGTHENED,
        at_rest=ObjectsAtRest,
        join=join,
        count_bytes=count_bytes,
    ),
    Sweeping(described_by=("looks.unit_patches",), in_turn_on_cpu=True),
)
