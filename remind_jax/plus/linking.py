"""Which detection goes on with which tracklet (method_plus.md#linking, method_plus.md#tracklets).

Letters: `N` detections, `T` tracklets, `D` feature dimension. Lengths in frame units.
"""

from __future__ import annotations

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from remind_jax.numerics.absent import NO_SLOT
from remind_jax.numerics.plane import (
    log_ratios,
    mean_sizes,
    middle_of,
    overlap_of,
    squared_length,
    turned,
    zoom_of,
)
from remind_jax.numerics.pooling import dot
from remind_jax.numerics.pytree import pytree
from remind_jax.numerics.ranks import count_before, largest
from remind_jax.plus import thresholds as th
from remind_jax.plus.class_names import vote
from remind_jax.plus.clock import MISSED_TICKS, share_in_deciding, tick_of
from remind_jax.plus.cropping import CROPPED_ODDS, Cropped, find_cropped
from remind_jax.plus.crossing import follow_courses
from remind_jax.plus.evidence import COSINE_DECAY, COSINE_VARIANCE, LEAST_COSINE_VARIANCE, log_tail
from remind_jax.plus.observation import Motion, Sightings
from remind_jax.plus.own_movement import expect_step, follow_movement, mobility, speed_of
from remind_jax.plus.slots import NO_ROW, rows_of
from remind_jax.plus.state import Scene, Tracklets
from remind_jax.plus.whitening import TEACHES, adjust_cosine, whiten_used
from remind_jax.solvers.assignment_in_graph import assign_in_graph

SMOOTHING = 4  # detections that the look of a tracklet averages
# How links score.
DISTANCE_MAX = 4.0  # relative distances count up to here
DISTANCE_SLACK = 0.12  # added to the scale of distances per tick unseen, length
LOOK_MIDDLE = 0.4  # cosine that says nothing
SIZE_LOSS = 0.5  # per log ratio of sizes, log odds
TRUST_SLOPE = 2.0  # log odds of one link beside another per difference of scores
# How alike looks are in two frames.
LINK_MEAN = 0.8  # cosine of a link before any was seen
ASSUMED_LINKS = 10.0  # samples that what is assumed counts for, of links and of two objects
BORDER_VARIANCE = 0.04  # squared cosine, more where the border of the frame cuts one off
CUT_SHARE = 0.5  # detections assumed of both kinds: those that go on over a cut, and the others


@pytree
class Links:
    """What may go on with what, by a motion of the image."""

    box: Float[Array, "T 4"]  # of the tracklets, where they should be now
    center: Float[Array, "T 2"]
    score: Float[Array, "N T"]
    possible: Bool[Array, "N T"]
    for_overlap: Float[Array, "N T"]  # what of the score is gained by overlap
    cropped: Cropped

    def with_odds(
        self, odds: Float[Array, "N T"], alike: Float[Array, "N T"], t: th.Linking
    ) -> Links:
        """The same with more evidence of each, and with what speaks for those that are possible."""
        score = self.score + odds
        possible = self.possible & (score > t.least)
        score += jnp.where(possible, alike, 0.0)
        return dataclasses.replace(self, score=score, possible=possible)


def carry(tracklets: Tracklets, motion: Motion, t: th.Mobility) -> Tracklets:
    """Moves boxes and centers along with the image, and on by what moves of its own."""
    turn = motion.matrix[:, :2]
    shift = motion.matrix[:, 2] + tick_of(motion.elapsed) * expect_step(tracklets, t)
    middle = turned(middle_of(tracklets.box), turn) + shift
    half = (tracklets.box[:, 2:] - tracklets.box[:, :2]) / 2 * zoom_of(turn)
    return dataclasses.replace(
        tracklets,
        box=jnp.concatenate([middle - half, middle + half], axis=1),
        center=turned(tracklets.center, turn) + shift,
    )


def link_odds(
    cosine: Float[Array, "N T"], border: Bool[Array, "N T"], scene: Scene, t: th.Calibration
) -> Float[Array, "N T"]:
    """Log odds that two looks are of one object in two frames.

    Rule: method_plus.md#linking. By what was learned of links, and of what is in view together.

    Args:
      border: Where the border of the frame cuts off one of them.
    """
    usual = jnp.stack([jnp.full_like(t.other_mean, LINK_MEAN), t.other_mean])
    assumed = jnp.stack([jnp.ones(2), usual, COSINE_VARIANCE + usual**2])
    seen = jnp.stack([scene.links, scene.apart], axis=1)
    weight, once, squares = seen + ASSUMED_LINKS * assumed
    mean = once / weight
    variance = jnp.maximum(squares / weight - mean**2, LEAST_COSINE_VARIANCE)
    # What is even less alike than others are tells no more than that.
    same, other = mean
    cosine = jnp.maximum(cosine, other)
    own = variance[0] + BORDER_VARIANCE * border
    odds = log_tail(cosine - other, variance[1]) - log_tail(jnp.minimum(cosine - same, 0.0), own)
    return odds + 0.5 * jnp.log(variance[1] / own)


def cut_odds(
    unlike: Float[Array, "N T"], tracklets: Tracklets, sightings: Sightings
) -> Float[Array, ""]:
    """Log odds, 0 at most, that anything goes on over a cut: how many detections look like it.

    Rule: method_plus.md#linking.

    Args:
      unlike: Log odds of `link_odds`, 0 at most.
      tracklets: Tracklets before the frame.
    """
    likely = jnp.max(jnp.where(tracklets.alive, jnp.exp(unlike), 0.0), axis=1)
    going_on = jnp.sum(jnp.where(sightings.valid, likely, 0.0))
    others = jnp.sum(sightings.valid) - going_on
    return jnp.minimum(jnp.log((going_on + CUT_SHARE) / (others + CUT_SHARE)), 0.0)


def learn_apart(
    scene: Scene, tracklets: Tracklets, cosine: Float[Array, "N N"], is_tick: Bool[Array, ""]
) -> Scene:
    """Learns how alike the looks of two objects are: of those in view together in the last frame.

    Args:
      tracklets: Tracklets before this frame, those of the last one first.
      cosine: Of their whitened looks.
      is_tick: Whether this frame counts.
    """
    num = len(cosine)
    seen = (tracklets.alive & tracklets.just_seen)[:num] & is_tick
    beside = seen[:, None] & seen & ~np.eye(num, dtype=bool)
    teaches = jnp.minimum(1.0, TEACHES / jnp.maximum(tracklets.age[:num], 1))[:, None]
    weight = teaches * beside / jnp.maximum(jnp.sum(beside, axis=1, keepdims=True), 1)
    # About the mean of few, these are less alike than what has no part in it.
    return dataclasses.replace(scene, apart=_learn(scene.apart, weight, jnp.maximum(cosine, 0.0)))


def likely_partners(
    links: Links, alive: Bool[Array, "T"], origin: Int[Array, "N"], t: th.Linking
) -> tuple[Int[Array, "N"], Float[Array, "N"]]:
    """The tracklet that each detection goes on with, or would, and how probably.

    What looks alone kept apart teaches how much looks change as well, or they could only seem to
    change little.
    """
    free = alive & (rows_of(origin, origin != NO_SLOT, len(alive)) == NO_ROW)
    best, nearest = largest(jnp.where(free, links.score, -jnp.inf))
    chance = jax.nn.sigmoid(TRUST_SLOPE * (best - t.least))
    linked = origin != NO_SLOT
    return jnp.where(linked, origin, nearest), jnp.where(linked, 1.0, chance)


def learn_links(
    scene: Scene,
    tracklets: Tracklets,
    cosine: Float[Array, "N T"],
    partner: Int[Array, "N"],
    weight: Float[Array, "N"],
) -> Scene:
    """Learns how alike the looks of an object are from one frame to the next.

    Args:
      tracklets: Tracklets before the frame.
      cosine: Of whitened looks.
      partner: The tracklet that each detection goes on with, or would.
      weight: How much each detection teaches.
    """
    value = jnp.take_along_axis(cosine, partner[:, None], axis=1)[:, 0]
    weight = jnp.where((tracklets.alive & tracklets.just_seen)[partner], weight, 0.0)
    return dataclasses.replace(scene, links=_learn(scene.links, weight, value))


def _learn(
    before: Float[Array, "3"], weight: Float[Array, "*any"], cosine: Float[Array, "*any"]
) -> Float[Array, "3"]:
    """Weight, sum and sum of squares of cosines with more of them."""
    new = jnp.stack([jnp.sum(weight * cosine**power) for power in range(3)])
    return before * COSINE_DECAY ** new[0] + new


def score_links(
    tracklets: Tracklets,
    sightings: Sightings,
    cosine: Float[Array, "N T"],
    look_odds: Float[Array, "N T"],
    tick: Float[Array, ""],
    t: th.PlusThresholds,
) -> Links:
    """How well each detection goes on with each tracklet, and where it may at all.

    Args:
      tracklets: Tracklets, carried to this frame.
      cosine: Of their whitened looks.
      look_odds: Log odds that these are looks and names of one object, as far as they count.
    """
    gap = tracklets.unseen + tick
    offset = sightings.center[:, None] - tracklets.center[None]
    distance = jnp.sqrt(squared_length(offset))
    scale = mean_sizes(sightings.size, tracklets.size)
    relative = jnp.minimum(distance / (scale + DISTANCE_SLACK * gap), DISTANCE_MAX)
    log_ratio = jnp.abs(log_ratios(sightings.size, tracklets.size))
    # What moves may be anywhere after a while; what stands still is where it was.
    moves = mobility(speed_of(tracklets), t.mobility)
    overlap = overlap_of(sightings.box, tracklets.box)
    cropped = find_cropped(tracklets, sightings, overlap, t.names)
    for_overlap = t.linking.overlap * jnp.where(cropped.is_pair, cropped.overlap, overlap)
    apart = t.linking.distance * relative + SIZE_LOSS * log_ratio
    odds = jnp.minimum(look_odds, 0.0)
    score = (
        for_overlap
        - jnp.where(cropped.is_pair, 0.0, apart)
        - 1.0
        + t.linking.look * (cosine - LOOK_MIDDLE)
        + jnp.where(cropped.is_pair, CROPPED_ODDS * odds, odds)
        - t.linking.missed * jnp.log2(jnp.maximum(gap, 1.0)) * moves
    )
    possible = sightings.valid[:, None] & tracklets.alive[None]
    possible &= score > t.linking.least
    return Links(tracklets.box, tracklets.center, score, possible, for_overlap, cropped)


def link(links: Links, t: th.Linking) -> Int[Array, "N"]:
    """The tracklet that each detection goes on with, NO_SLOT for the first of a new one."""
    num, possible = len(links.score), links.possible
    # Most detections may go on with one tracklet, and it with no other.
    clear = possible & (jnp.sum(possible, axis=0) == 1) & (jnp.sum(possible, axis=1) == 1)[:, None]
    alone, one_group = jnp.full(num, t.least), jnp.zeros(num, jnp.int32)
    others = possible & ~clear
    found = assign_in_graph(links.score, others, one_group, alone, jnp.array(True))
    return jnp.where(jnp.any(clear, axis=1), largest(clear)[1], found)


def trust_links(
    links: Links, origin: Int[Array, "N"], t: th.Linking
) -> tuple[Float[Array, "N"], Float[Array, "T"]]:
    """How probable each link is beside those with another tracklet; 1 where there is none.

    Rule: method_plus.md#answers. What goes on with that tracklet goes on with this one instead, or
    is the first of a new one.

    Returns:
      That of each detection; and how probable it is that what a waiting tracklet shows did not go
      on with another one, 1 where it does not wait.
    """
    num = links.score.shape[1]
    linked, at = origin != NO_SLOT, jnp.maximum(origin, 0)[:, None]
    holder = rows_of(origin, linked, num)
    by = jnp.maximum(holder, 0)
    own = jnp.take_along_axis(links.score, at, axis=1)
    exchanged = jnp.maximum(links.score[by, at], t.least)
    lost = own + jnp.where(holder != NO_ROW, own[by, 0] - exchanged, 0.0)
    others = links.possible & linked[:, None] & (jnp.arange(num) != at)
    odds = jnp.exp(TRUST_SLOPE * jnp.minimum(links.score - lost, 0.0)) * others
    trust = 1.0 / (1.0 + jnp.sum(odds, axis=1))
    elsewhere = jnp.minimum(jnp.sum(odds * trust[:, None], axis=0), 1.0)
    return trust, jnp.where(holder == NO_ROW, 1.0 - elsewhere, 1.0)


def advance_tracklets(
    tracklets: Tracklets,
    sightings: Sightings,
    origin: Int[Array, "N"],
    frame: Int[Array, ""],
    next_id: Int[Array, ""],
    counts: Bool[Array, "N"],
    cropped: Bool[Array, "N"],
    elapsed: Float[Array, ""],
    shift: Float[Array, ""],
    doubt: Float[Array, ""],
    t: th.Mobility,
) -> tuple[Tracklets, Int[Array, ""], Float[Array, "N D"]]:
    """Continues, starts and drops tracklets.

    Args:
      tracklets: Tracklets, carried to this frame.
      origin: The tracklet that each of them goes on with, NO_SLOT for the first of a new one.
      counts: Detections that count: those of a tick, and first ones.
      cropped: Those that are cropped beside their tracklet, or whole again: its looks begin anew.
      elapsed: Ticks since the last frame.
      shift: How far the image moved since the last frame.
      doubt: How little that is believed, [0, 1].

    Returns:
      Tracklets: those of the detections, in their order, then those of the frames before, of which
      some may still resume; the next free id; and how far each look is from the smoothed look
      before, 0 for the first one.
    """
    num = len(origin)
    linked = origin != NO_SLOT
    old = jax.tree.map(lambda leaf: leaf[jnp.where(linked, origin, 0)], tracklets)
    class_id, lead = vote(old.class_id, old.class_lead, sightings.class_id, linked)
    starts = sightings.valid & ~linked
    age = jnp.where(linked, old.age, 0) + counts
    tick = tick_of(elapsed)
    has_ring = sightings.has_ring & counts
    ring_count = jnp.where(linked, old.ring_count, 0) + has_ring

    def go_on(before: Array, first: Array | float, goes_on: Bool[Array, "N"] = linked) -> Array:
        return jnp.where(goes_on.reshape(-1, *[1] * (before.ndim - 1)), before, first)

    # Looks and backgrounds are running means; the first look stays.
    same = linked & ~cropped
    look, ring = go_on(old.look, sightings.look, same), go_on(old.ring, 0.0)
    step = sightings.look - look
    # Of two that pass behind each other each keeps the look that it had, whoever it is linked with.
    look_rate = 1.0 / jnp.clip(age, 1, SMOOTHING) * (linked & counts & (old.met == 0))
    ring_rate = 1.0 / jnp.clip(ring_count, 1, SMOOTHING) * has_ring
    # Courses, and whom each met, are left to `follow_courses`.
    here = dataclasses.replace(
        old,
        alive=sightings.valid,
        id=go_on(old.id, next_id + count_before(starts)),
        class_id=go_on(class_id, sightings.class_id),
        class_lead=go_on(lead, 1),
        last_class=sightings.class_id,
        slot=go_on(old.slot, NO_SLOT),
        last=jnp.full(num, frame, jnp.int32),
        unseen=jnp.zeros(num, jnp.float32),
        age=age,
        duration=go_on(old.duration + share_in_deciding(elapsed), 1.0),
        box=sightings.box,
        center=sightings.center,
        size=sightings.size,
        touched=sightings.touches,
        look=look + look_rate[:, None] * step,
        first_look=go_on(old.first_look, sightings.look, same),
        ring=ring + ring_rate[:, None] * (sightings.ring - ring),
        ring_count=ring_count,
        belief=go_on(old.belief, 0.0),
        trust=go_on(old.trust, 1.0),
        fresh=linked & old.fresh,
        named=linked & old.named,
        leans_new=linked & old.leans_new,
        **follow_movement(old, same, sightings, tick, shift, doubt, t),
    )
    taken = rows_of(origin, linked, len(tracklets.alive)) != NO_ROW
    stays = tracklets.alive & ~taken & (tracklets.unseen < MISSED_TICKS)
    others = dataclasses.replace(tracklets, alive=stays, unseen=tracklets.unseen + tick)
    # Those that wait stay in the order in which they were last seen; the latest have room.
    waiting = jnp.argsort(~stays, stable=True)[: len(stays) - num]
    both = jax.tree.map(lambda now, old: jnp.concatenate([now, old[waiting]]), here, others)
    both = follow_courses(both, linked, old.unseen + tick, tick)
    return both, next_id + jnp.sum(starts, dtype=jnp.int32), step


def compare_looks(
    tracklets: Tracklets, sightings: Sightings, scene: Scene
) -> tuple[Float[Array, "N T"], Float[Array, "N N"]]:
    """Cosines of whitened looks: with tracklets, and of those of the last frame with each other.

    Not of their backgrounds: what passes one spot has one background, whoever it is. The cosine
    says nothing where a look is the mean of all.
    """

    def whiten_objects(looks: Float[Array, "X D"], used: Bool[Array, "X"]) -> Float[Array, "X E"]:
        looks = jnp.where(sightings.is_background, scene.white_mean, looks)
        return whiten_used(scene, looks, used)

    here = whiten_objects(sightings.look, sightings.valid)
    before = whiten_objects(tracklets.look, tracklets.alive)
    last = before[: len(here)]
    known = jnp.any(here != 0.0, axis=1)[:, None] & jnp.any(before != 0.0, axis=1)
    likeness = jnp.where(known, adjust_cosine(scene, dot(here, before)), LOOK_MIDDLE)
    return likeness, adjust_cosine(scene, dot(last, last))
