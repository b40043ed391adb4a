"""REMIND plus on one page: the pure step from one frame to the next (docs/method_plus.md).

Frame to frame linking is nearly free of errors, so the tracklet gets an identity, not the
detection. All open tracklets of a frame are decided together, from looks, place, and what lies
beside them.
"""

from __future__ import annotations

import dataclasses
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from remind_jax.decision import Outcome, Overflow, Reason
from remind_jax.numerics.absent import NO_SLOT
from remind_jax.numerics.control_flow import batch_max, branch
from remind_jax.plus import clock
from remind_jax.plus.answers import believe, conclude, report
from remind_jax.plus.class_names import confusion_odds, learn_names, name_odds
from remind_jax.plus.cropping import find_cropped_doubles
from remind_jax.plus.crossing import carry_courses, course_odds
from remind_jax.plus.decision import decide, learn_newness
from remind_jax.plus.evidence import Shortlist, best_cosine, find_ended, shortlist
from remind_jax.plus.layout import Weighed, nothing_weighed, weigh_jointly
from remind_jax.plus.learning import (
    KeptLooks,
    keep_looks,
    learn_cosines,
    learn_objects,
    learn_relations,
)
from remind_jax.plus.linking import (
    advance_tracklets,
    compare_looks,
    cut_odds,
    learn_apart,
    learn_links,
    likely_partners,
    link,
    link_odds,
    trust_links,
)
from remind_jax.plus.motion_check import check_motion
from remind_jax.plus.observation import Motion, Sightings
from remind_jax.plus.own_movement import (
    fade_background,
    first_speed,
    learn_speeds,
    mobility_of,
    staying_of_class,
)
from remind_jax.plus.scene_change import fade_cosines, is_another, looks_left
from remind_jax.plus.scene_map import center_variance, correct_map, doubt_of, move_map, shift_of
from remind_jax.plus.slots import NO_ROW, create_objects, rows_of
from remind_jax.plus.state import Objects, Pairs, PlusState, Scene, Tracklets, init
from remind_jax.plus.thresholds import PlusThresholds
from remind_jax.plus.verdicts import Verdicts, no_verdicts
from remind_jax.plus.whitening import (
    adjust_cosine,
    class_offset,
    learn_scatter,
    renew_whitening,
    share_of,
    whiten_used,
)
from remind_jax.static import Static

__all__ = ["advance", "init"]


def advance(
    state: PlusState,
    sightings: Sightings,
    motion: Motion,
    present: Bool[Array, "N"],
    *,
    static: Static,
    thresholds: PlusThresholds,
) -> tuple[PlusState, Verdicts]:
    """Decides who is who in one frame and remembers it.

    Args:
      state: Memory before the frame, from `init` or an earlier step.
      present: Slots that hold a mask.
      static: Capacities; those that `state` was made with.

    Returns:
      Memory after the frame, and what its decisions are made of. If the frame may need more object
      slots than there are, only `overflow` is changed; a batch shares its capacities, so what one
      of its members lacks, all of them do.
    """
    t = thresholds.as_arrays()
    sightings, motion = jax.tree.map(_single, (sightings, motion))
    linked = _link(state, sightings, motion, t)
    # Each open tracklet may become an object.
    counted = jnp.concatenate([state.objects.exists, linked.tracklets.is_open])
    needed = batch_max(jnp.sum(counted, dtype=jnp.int32))
    fits = needed <= static.num_objects
    lacking = Overflow(objects=needed, pending=jnp.int32(0))
    nothing = dataclasses.replace(state, overflow=lacking), no_verdicts(static.num_detections)
    return branch(
        fits,
        lambda: jax.tree.map(
            lambda new, old: new.astype(old.dtype),
            _recognize(state, linked, present, static, t),
            nothing,
        ),
        lambda: nothing,
    )


def _single(leaf: Array) -> Array:
    """In 32 bits, also where JAX computes in 64: the memory holds nothing else."""
    leaf = jnp.asarray(leaf)
    if jnp.issubdtype(leaf.dtype, jnp.floating):
        return leaf.astype(jnp.float32)
    return leaf.astype(jnp.int32) if jnp.issubdtype(leaf.dtype, jnp.integer) else leaf


class _Linked(NamedTuple):
    """Where everything is in a frame: its detections go on with tracklets, or begin new ones."""

    elapsed: Float[Array, ""]  # ticks since the last frame
    tick: Float[Array, ""]  # as far as they count, one at most
    is_tick: Bool[Array, ""]  # whether another tick of the clock is full
    sightings: Sightings  # without those that show a thing twice
    double_of: Int[Array, "N"]  # of those that do: the detection that shows it, else NO_SLOT
    origin: Int[Array, "N"]  # the tracklet before the frame that each goes on with
    cropped: Bool[Array, "N"]  # cropped beside it, or whole again
    counts: Bool[Array, "N"]  # those that teach
    change: Float[Array, "N D"]  # of their looks
    likeness: Float[Array, "N T"]  # cosines of looks with the tracklets before the frame
    confused: Float[Array, "L L"]  # log odds that one class is named as another
    trust: Float[Array, "N"]  # how probable each link is
    tracklets: Tracklets  # those of the detections first
    next_id: Int[Array, ""]
    doubt: Float[Array, ""]  # how little the estimated motion of the image is believed
    objects: Objects  # where they are by the motion of the image
    pairs: Pairs
    scene: Scene  # with what those in view together in the last frame taught
    partner: Int[Array, "N"]  # the tracklet before the frame that each goes on with, or would
    is_partner: Float[Array, "N"]  # how probably


def _link(
    state: PlusState,
    sightings: Sightings,
    motion: Motion,
    t: PlusThresholds,
) -> _Linked:
    frame = state.frame
    # Frames come as fast as the camera gives them; what they teach is counted by the clock.
    tick = clock.tick_of(motion.elapsed)
    is_tick = state.phase + tick >= 1.0 - clock.SLACK
    likeness, apart = compare_looks(state.tracklets, sightings, state.scene)
    scene = learn_apart(state.scene, state.tracklets, apart, is_tick)
    border = sightings.touches[:, None] | state.tracklets.touched
    by_looks = link_odds(likeness, border, scene, t.calibration)
    unlike = jnp.minimum(by_looks, 0.0)
    confused = confusion_odds(scene, t.names)
    # Where the image goes on, so do most of its objects.
    doubt = doubt_of(motion)
    look_odds = unlike + doubt * cut_odds(unlike, state.tracklets, sightings)
    look_odds += name_odds(sightings.class_id, state.tracklets.class_id, confused)
    motion, links = check_motion(motion, state.tracklets, sightings, likeness, look_odds, t)
    objects, pairs = move_map(
        state.objects,
        state.pairs,
        motion,
        sightings.frame_center,
        frame,
        tick,
        t.motion,
        t.mobility,
    )
    course = carry_courses(state.tracklets, motion)
    carried = dataclasses.replace(
        state.tracklets, box=links.box, center=links.center, course=course
    )
    # Which detection goes on with which tracklet?
    lost = doubt * links.for_overlap  # over a cut one place is as good as another
    # Looks that are alike make nothing possible; they say which of the possible ones it is.
    alike = by_looks - unlike
    links = links.with_odds(course_odds(carried, sightings.box) - lost, alike, t.linking)
    origin = link(links, t.linking)
    sightings = fade_background(sightings, origin, carried, scene, t.mobility)
    age = jnp.where(origin == NO_SLOT, 0, carried.age[origin])
    double_of = find_cropped_doubles(sightings, origin, age, confused, t.names)
    sightings = dataclasses.replace(sightings, valid=sightings.valid & (double_of == NO_SLOT))
    cropped = links.cropped.at(origin)
    partner, is_partner = likely_partners(links, carried.alive, origin, t.linking)
    link_trust, wait_trust = trust_links(links, origin, t.linking)
    counts = sightings.valid & (is_tick | (origin == NO_SLOT))
    tracklets, next_id, change = advance_tracklets(
        _trusted(carried, wait_trust),
        sightings,
        origin,
        frame,
        state.next_id,
        counts,
        cropped,
        motion.elapsed,
        shift_of(motion, sightings.frame_center),
        doubt_of(motion),
        t.mobility,
    )
    return _Linked(
        elapsed=motion.elapsed,
        tick=tick,
        is_tick=is_tick,
        sightings=sightings,
        double_of=double_of,
        origin=origin,
        cropped=cropped,
        counts=counts,
        change=change,
        likeness=likeness,
        confused=confused,
        trust=link_trust,
        tracklets=tracklets,
        next_id=next_id,
        doubt=doubt,
        objects=objects,
        pairs=pairs,
        scene=scene,
        partner=partner,
        is_partner=jnp.where(cropped, 0.0, is_partner),
    )


def _recognize(
    state: PlusState,
    linked: _Linked,
    present: Bool[Array, "N"],
    static: Static,
    t: PlusThresholds,
) -> tuple[PlusState, Verdicts]:
    frame, num = state.frame, static.num_detections
    sightings, tracklets = linked.sightings, linked.tracklets
    objects, pairs = linked.objects, linked.pairs
    origin, counts, confused = linked.origin, linked.counts, linked.confused
    here = _trusted(jax.tree.map(lambda leaf: leaf[:num], tracklets), linked.trust)
    # Which differences of looks matter in this scene?
    share = jnp.where(counts, share_of(here, objects), 0.0)
    alike = jnp.where(linked.cropped, NO_SLOT, origin)
    begins = sightings.valid & (origin == NO_SLOT)
    another = is_another(begins, sightings.valid, linked.doubt)
    left = looks_left(linked.scene, sightings, begins, another)
    scene = fade_cosines(linked.scene, another)
    scene = learn_scatter(
        scene, sightings, linked.change, alike != NO_SLOT, share, frame, left=left
    )
    scene = learn_links(
        scene, state.tracklets, linked.likeness, linked.partner, linked.is_partner * share
    )
    before = jnp.maximum(origin, 0)
    goes_on = (origin != NO_SLOT) & state.tracklets.just_seen[before]
    scene = learn_names(
        scene, state.tracklets.class_id[before], sightings.class_id, jnp.where(goes_on, share, 0.0)
    )
    is_double, other = linked.double_of != NO_SLOT, jnp.maximum(linked.double_of, 0)
    told = jnp.where(is_double, share[other], 0.0)
    scene = learn_names(scene, sightings.class_id[other], sightings.class_id, told)
    scene, objects = renew_whitening(scene, objects, sightings, frame, t)
    # What could every open tracklet be?
    is_open = here.is_open
    visible = sightings.valid & (here.slot != NO_SLOT)
    holder = rows_of(tracklets.slot, tracklets.alive, static.num_objects)
    held, waiting = (holder != NO_ROW) & (holder < num), holder >= num
    looks = jnp.stack([here.look, here.first_look], axis=1)
    looks -= class_offset(scene, here.class_id)[:, None]
    white, white_first = jnp.moveaxis(whiten_used(scene, looks, here.alive), 1, 0)
    cosine = adjust_cosine(scene, best_cosine(white, objects))

    def weigh() -> tuple[Shortlist, Weighed]:
        admitted = is_open[:, None] & objects.exists & ~held
        names = name_odds(here.class_id, objects.class_id, confused)
        best = shortlist(
            here, sightings, admitted, waiting, cosine, names, objects, pairs, scene, t
        )
        return best, weigh_jointly(
            best, here.slot, visible, sightings, objects, pairs, state.ticks, t
        )

    # In many frames everything in view is decided.
    candidates, weighed = branch(jnp.any(is_open), weigh, lambda: nothing_weighed(num))
    # Who is who, jointly?
    stays = staying_of_class(here.class_id, objects, t.mobility)
    choice = decide(
        candidates, weighed.odds, is_open, here, stays, scene, static.num_objects, t.decision
    )
    verdicts = conclude(here, objects, is_open, candidates, weighed, choice)
    answered = jnp.where(choice.slot != NO_SLOT, choice.slot, here.slot)
    moves = mobility_of(answered, objects, t.mobility)
    decisions = report(verdicts, moves, stays, here, present, sightings, static, t.decision)
    reason = jnp.where(is_double, int(Reason.DOUBLE), decisions.reason)
    decisions = dataclasses.replace(decisions, reason=reason)
    # What does that teach?
    scene, objects = learn_newness(scene, objects, choice, here.class_id, candidates)
    ended = find_ended(tracklets, linked.elapsed, t.decision)
    unseen = len(ended) - num
    touches = jnp.pad(sightings.touches, (0, unseen), constant_values=True)
    objects, pairs, slots = create_objects(
        objects,
        pairs,
        tracklets,
        ended | jnp.pad(choice.born, (0, unseen)),
        center_variance(tracklets.size, touches),
        first_speed(tracklets, scene),
    )
    slot = jnp.where(choice.recognized, choice.slot, slots[:num])
    here = dataclasses.replace(
        here,
        slot=slot,
        fresh=here.fresh | choice.born,
        named=here.named | (decisions.outcome == int(Outcome.NEW)),
        leans_new=choice.slot == NO_SLOT,
        belief=believe(verdicts, here),
    )
    sure = sightings.valid & (slot != NO_SLOT)
    row = rows_of(slot, sure, static.num_objects)
    teaches = sure & counts
    teacher = rows_of(slot, teaches, static.num_objects)
    objects, pairs = correct_map(objects, pairs, slot, teaches, teaches & ~choice.born, sightings)
    since_first = adjust_cosine(scene, jnp.sum(white * white_first, axis=1))
    scene = learn_cosines(
        scene, objects, here, sure, choice, cosine, since_first, share, state.ticks
    )
    objects, scene = learn_speeds(objects, scene, here, counts, teacher)
    pairs = learn_relations(objects, pairs, teacher, sightings, linked.tick, t.mobility)
    objects = learn_objects(objects, teacher, sightings, frame)
    looks_in_view = KeptLooks.in_view(objects, here, sure, counts, sightings)
    looks_of_ended = KeptLooks(slots[num:], tracklets.look[num:], ended[num:])
    objects = keep_looks(objects, scene, (looks_of_ended, looks_in_view), t.memory)
    passed = state.phase + linked.tick
    after = PlusState(
        objects=objects,
        pairs=pairs,
        tracklets=_settle(tracklets, here, slots[num:], ended[num:], row),
        scene=scene,
        next_id=linked.next_id,
        frame=frame + 1,
        ticks=state.ticks + linked.is_tick,
        phase=jnp.where(linked.is_tick, passed - 1.0, passed),
        decisions=decisions,
        answers=verdicts.answers,
        overflow=Overflow(objects=jnp.int32(0), pending=jnp.int32(0)),
    )
    return after, verdicts


def _trusted(tracklets: Tracklets, probability: Float[Array, "T"]) -> Tracklets:
    """Tracklets that show what they showed before as probably as that."""
    return dataclasses.replace(
        tracklets,
        belief=tracklets.belief * probability,
        trust=jnp.where(tracklets.slot == NO_SLOT, 1.0, tracklets.trust * probability),
    )


def _settle(
    tracklets: Tracklets,
    here: Tracklets,
    slot: Int[Array, "M"],
    ended: Bool[Array, "M"],
    row: Int[Array, "O"],
) -> Tracklets:
    """All tracklets after the decisions; one whose object is another's now cannot resume.

    So no object ever belongs to two tracklets, and no identity is given twice in a frame.

    Args:
      tracklets: All of them before the decisions, those of this frame first.
      here: Those of this frame.
      slot: Objects of the others.
      ended: Others that just became an object.
      row: Which tracklet of this frame each object belongs to.
    """
    num = len(here.alive)
    lost = (slot != NO_SLOT) & (row[slot] != NO_ROW)
    same = ("named", "leans_new", "belief", "trust")
    others = {
        "alive": tracklets.alive[num:] & ~lost,
        "slot": slot,
        "fresh": tracklets.fresh[num:] | ended,
    } | {name: getattr(tracklets, name)[num:] for name in same}
    # Decisions change nothing else: what is large is not copied.
    return dataclasses.replace(
        tracklets,
        **{name: jnp.concatenate([getattr(here, name), leaf]) for name, leaf in others.items()},
    )
