"""REMIND plus on one page: the pure step from one frame to the next (notes of REMIND plus, 5).

Frame to frame linking is nearly free of errors, so the tracklet gets an identity, not the
detection. All open tracklets of a frame are decided together, from looks, place, and what lies
beside them.
"""

from __future__ import annotations

import dataclasses

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from remind_jax.observation import FrameFeats, Masks
from remind_jax.plus.decision import Choice, decide, learn_familiarity
from remind_jax.plus.evidence import (
    Rows,
    Shortlist,
    admit,
    best_cosine,
    find_rows,
    held_objects,
    shortlist,
)
from remind_jax.plus.layout import weigh_jointly
from remind_jax.plus.learning import (
    absorb,
    create_objects,
    learn_cosines,
    learn_objects,
    learn_relations,
)
from remind_jax.plus.linking import (
    advance_tracklets,
    carry,
    compare_looks,
    link,
    score_links,
)
from remind_jax.plus.motion_check import check_motion
from remind_jax.plus.observation import Motion, Sightings, frame_unit, in_frame_units, observe
from remind_jax.plus.scene_map import center_variance, correct_map, move_map
from remind_jax.plus.state import NOWHERE, Objects, PlusState, Tracklets, Verdicts, init
from remind_jax.plus.static import PlusStatic
from remind_jax.plus.thresholds import PlusThresholds
from remind_jax.plus.whitening import learn_rings, learn_scatter, renew_whitening, whiten

__all__ = ["advance", "init", "step"]


def step(
    state: PlusState,
    frame_feats: FrameFeats,
    masks: Masks,
    motion: Motion,
    *,
    static: PlusStatic,
    thresholds: PlusThresholds,
) -> PlusState:
    """Decides who is who in one frame and remembers it.

    Pure: `jit` (with `static` static), `vmap` and `scan` apply unchanged.

    Args:
      state: Memory before the frame, from `init` or an earlier step.
      frame_feats: Patch features; `frame_size` is that of the pixels of the masks.
      masks: Detections.
      motion: How the image moved since the last frame, in the same pixels.
      static: Capacities; those that `state` was made with.
      thresholds: Every tunable number.

    Returns:
      Memory after the frame with `verdicts` about it. If the frame may need more object slots than
      there are, only `overflow` is changed.
    """
    t = thresholds.as_arrays()
    sightings = observe(frame_feats, masks, t.looks.unit_patches)
    moved = in_frame_units(motion, frame_unit(frame_feats.frame_size))
    return advance(state, sightings, moved, static=static, thresholds=t)


def advance(
    state: PlusState,
    sightings: Sightings,
    motion: Motion,
    *,
    static: PlusStatic,
    thresholds: PlusThresholds,
) -> PlusState:
    """`step` on detections that are described already; lengths in frame units."""
    t = thresholds.as_arrays()
    needed = jnp.sum(state.objects.exists) + jnp.sum(sightings.valid)
    fits = needed <= static.num_objects
    return jax.lax.cond(
        fits,
        lambda state: _advance(state, sightings, motion, static, t),
        lambda state: dataclasses.replace(state, overflow=needed.astype(jnp.int32)),
        state,
    )


def _advance(
    state: PlusState,
    sightings: Sightings,
    motion: Motion,
    static: PlusStatic,
    t: PlusThresholds,
) -> PlusState:
    frame, num = state.frame, static.num_detections
    # Where is everything in this frame?
    likeness = compare_looks(state.tracklets, sightings, state.scene)
    motion = check_motion(motion, state.tracklets, sightings, likeness, frame, t)
    objects, pairs = move_map(
        state.objects, state.pairs, motion, sightings.frame_center, frame, t.motion
    )
    carried = carry(state.tracklets, motion)
    # Which detection goes on with which tracklet?
    score, possible = score_links(carried, sightings, likeness, frame, t.linking)
    origin = link(score, possible, sightings.class_id, t.linking)
    tracklets, next_id, change = advance_tracklets(
        carried, sightings, origin, frame, state.next_id, t.linking
    )
    here = jax.tree.map(lambda leaf: leaf[:num], tracklets)
    # What do looks tell in this scene?
    scene = learn_scatter(
        state.scene, sightings.look, sightings.valid, change, origin != NOWHERE, t.looks
    )
    scene = learn_rings(scene, sightings.ring, sightings.has_ring, t.looks)
    scene, objects = renew_whitening(scene, objects, frame, t.looks)
    # What could every open tracklet be?
    rows = find_rows(here, sightings.valid, t.decision)
    visible = sightings.valid & (here.slot != NOWHERE)
    held = held_objects(here.slot, visible, static.num_objects)
    waiting = held_objects(tracklets.slot[num:], tracklets.alive[num:], static.num_objects)
    held |= waiting & t.decision.hold_missed
    admitted = admit(here, rows, held, objects, pairs)
    cosine = best_cosine(whiten(scene, here.look), objects)
    candidates = shortlist(
        here, sightings, admitted, cosine, objects, pairs, scene, t, static.num_candidates
    )
    # Who is who, jointly?
    odds, belief = weigh_jointly(
        candidates, here.slot, visible & ~rows.late, sightings, objects, pairs, t,
        static.num_rounds,
    )  # fmt: skip
    choice = decide(candidates, odds, rows, here, scene, static.num_objects, t.decision)
    verdicts = _tell(here, objects, sightings.valid, rows, candidates, odds, belief, choice)
    # What does that teach?
    scene = learn_familiarity(scene, choice, t.decision)
    objects, pairs, slot = create_objects(
        objects, pairs, here, choice.born, center_variance(sightings, t.place), frame
    )
    objects, pairs = jax.lax.cond(
        jnp.any(choice.absorbed),
        lambda objects, pairs: absorb(
            objects, pairs, scene, slot, choice.slot, choice.absorbed, t.memory
        ),
        lambda *same: same,
        objects,
        pairs,
    )
    slot = jnp.where(choice.recognised | choice.absorbed, choice.slot, slot)
    fresh = (here.fresh | choice.born) & ~choice.absorbed
    here = dataclasses.replace(here, slot=slot, fresh=fresh)
    sure = sightings.valid & (slot != NOWHERE)
    objects, pairs = correct_map(
        objects, pairs, slot, sure, sure & ~choice.born, sightings, t.place
    )
    scene = learn_cosines(scene, here, sure, choice, cosine, frame, t.calibration)
    pairs = learn_relations(objects, pairs, slot, sure, sightings, t.layout)
    objects = learn_objects(objects, scene, here, sure, sightings, frame, t.memory)
    return PlusState(
        objects=objects,
        pairs=pairs,
        tracklets=_settle(tracklets, here, static.num_objects),
        scene=scene,
        next_id=next_id,
        frame=frame + 1,
        verdicts=verdicts,
        num_bad_patches=sightings.num_bad_patches,
        overflow=jnp.int32(0),
    )


def _settle(tracklets: Tracklets, here: Tracklets, num_objects: int) -> Tracklets:
    """All tracklets after the decisions; one whose object is another's now cannot resume.

    So no object ever belongs to two tracklets, and no identity is given twice in a frame.
    """
    num = len(here.alive)
    slot = jnp.concatenate([here.slot, tracklets.slot[num:]])
    fresh = jnp.concatenate([here.fresh, tracklets.fresh[num:]])
    held = held_objects(here.slot, here.alive & (here.slot != NOWHERE), num_objects)
    lost = (slot != NOWHERE) & held[jnp.maximum(slot, 0)] & (jnp.arange(len(slot)) >= num)
    return dataclasses.replace(tracklets, slot=slot, fresh=fresh, alive=tracklets.alive & ~lost)


def _tell(
    here: Tracklets,
    objects: Objects,
    valid: Bool[Array, "N"],
    rows: Rows,
    candidates: Shortlist,
    odds: Float[Array, "N C"],
    belief: Float[Array, "N C"],
    choice: Choice,
) -> Verdicts:
    """What to show of each detection."""

    def id_of(slot: Int[Array, "*any"]) -> Int[Array, "*any"]:
        return objects.id[jnp.maximum(slot, 0)]

    own = jnp.where(here.slot != NOWHERE, id_of(here.slot), here.id)
    is_known = choice.slot != NOWHERE
    answer = jnp.where(is_known, id_of(choice.slot), own)
    order = jnp.argsort(-belief, axis=1, stable=True)
    sorted_belief = jnp.take_along_axis(belief, order, axis=1)
    shown = jnp.take_along_axis(candidates.valid, order, axis=1) & rows.young[:, None]
    ids = jnp.take_along_axis(id_of(candidates.slot), order, axis=1)
    chosen = candidates.valid & (candidates.slot == choice.slot[:, None])
    known_belief = jnp.sum(jnp.where(chosen, belief, 0.0), axis=1)
    new_belief = 1.0 - jnp.sum(jnp.where(candidates.valid, belief, 0.0), axis=1)
    return Verdicts(
        valid=valid,
        object_id=jnp.where(valid, answer, -1),
        tracklet_id=jnp.where(valid, here.id, -1),
        is_decided=valid & ~(rows.young & ~choice.recognised & ~choice.born),
        is_new=rows.young & ~is_known,
        margin=jnp.where(rows.any, choice.margin, jnp.inf),
        probability=jnp.where(rows.any, jnp.where(is_known, known_belief, new_belief), 1.0),
        candidate_id=jnp.where(shown, ids, -1),
        candidate_probability=jnp.where(shown, sorted_belief, 0.0),
        merged_id=jnp.where(choice.absorbed, id_of(here.slot), -1),
    )
