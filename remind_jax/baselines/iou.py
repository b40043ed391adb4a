"""Overlap of boxes from frame to frame, after SORT (Bewley et al. 2016) without its Kalman filter.

It never looks at an image, so whoever leaves the view returns as somebody new. Ours, not a
library's: Roboflow's `trackers` brings a second OpenCV, `norfair` an old NumPy, and both are loops
over host objects that neither compile nor resume like the other methods.

Letters: `O` object slots.
"""

from __future__ import annotations

import dataclasses
from typing import Any

import jax.numpy as jnp
from jaxtyping import Array, Float

from remind_jax.baselines.parts import scene_memory
from remind_jax.baselines.parts.scene_memory import Matching, SceneMemory
from remind_jax.method import Host, Method, Needs, Sweeping
from remind_jax.numerics.absent import NO_ID
from remind_jax.numerics.constant_arrays import zeros
from remind_jax.numerics.plane import overlap_of
from remind_jax.numerics.pytree import pytree
from remind_jax.observation import AnyFeats, Masks, without_coverage
from remind_jax.settings.kinds import Real, Whole
from remind_jax.settings.record import setting
from remind_jax.solvers.assignment import assign
from remind_jax.static import Static


@pytree
class IouThresholds:
    """Numbers of the IoU tracker; those of SORT."""

    min_iou: Real = setting(0.3, "least overlap of a match", "share")
    patience: Whole = setting(
        1, "frames after which an object that is not seen again is forgotten", "frames"
    )


@pytree
class LastBoxes:
    """Where each object was seen last."""

    box: Float[Array, "O 4"]  # left, top, right, bottom in pixels


def init(static: Static) -> SceneMemory:
    """The empty memory."""
    return scene_memory.empty_memory(static, LastBoxes(zeros((static.num_objects, 4))))


def describe(
    frame_feats: AnyFeats, masks: Masks, observed: Any, *, static: Static, thresholds: IouThresholds
) -> Masks:
    """Boxes say it all."""
    return without_coverage(masks)


def decide(
    state: SceneMemory, masks: Masks, *, static: Static, thresholds: IouThresholds
) -> tuple[SceneMemory, None]:
    """Maximizes the summed overlap with the last boxes, class by class; the rest is new."""
    state = _forget(state, thresholds)
    boxes = jnp.asarray(masks.box, jnp.float32)
    score = overlap_of(boxes, state.looks.box)
    allowed = scene_memory.same_class(state, masks) & (score >= thresholds.min_iou)
    # Any overlap that is allowed is better than none.
    nothing = jnp.zeros(len(masks.valid), jnp.float32)
    column = assign(score, allowed, masks.class_id, nothing, jnp.array(True), solver=static.solver)

    def learn(last: LastBoxes, slot: Array, starts: Array) -> LastBoxes:
        return LastBoxes(last.box.at[slot].set(boxes, mode="drop"))

    matching = Matching(score, allowed, column, masks.valid, masks.valid)
    return scene_memory.conclude(state, masks, matching, learn, static), None


def _forget(state: SceneMemory, thresholds: IouThresholds) -> SceneMemory:
    """Frees the slots of objects that have not been seen for too long."""
    objects = state.objects
    is_old = state.frame - objects.last_seen > thresholds.patience
    kept = dataclasses.replace(objects, id=jnp.where(is_old, NO_ID, objects.id))
    return dataclasses.replace(state, objects=kept)


METHOD = Method(
    "iou",
    IouThresholds,
    init,
    decide,
    describe,
    Needs(patch_reach=0),
    Host(remove=scene_memory.remove_objects, find_faults=scene_memory.find_faults),
    Sweeping(described_by=()),
    title="IoU",
)
