"""What looks, background and place say about an open tracklet and each object.

Rule: method_plus.md#evidence.

Letters: `N` detections, `O` object slots, `C` candidates, `X` either. Evidence is in log odds.
"""

from __future__ import annotations

import dataclasses
import functools
import math
import operator
from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from remind_jax.numerics.control_flow import fill_blocks
from remind_jax.numerics.plane import squared_length
from remind_jax.numerics.pooling import dot, to_unit
from remind_jax.numerics.pytree import pytree
from remind_jax.numerics.ranks import largest
from remind_jax.numerics.row_lookup import look_up_in_rows
from remind_jax.plus import thresholds as th
from remind_jax.plus.class_names import name_row
from remind_jax.plus.clock import MISSED_TICKS, SLACK, share_in_deciding, tick_of
from remind_jax.plus.observation import Sightings
from remind_jax.plus.own_movement import mobility
from remind_jax.plus.scene_map import center_variance
from remind_jax.plus.small_matrices import diagonal
from remind_jax.plus.state import Objects, Pairs, Scene, Tracklets
from remind_jax.plus.static import NUM_CANDIDATES, OBJECTS_BLOCK

_EXPONENT_MAX = 80.0  # squared distances beyond do not count
# Cosines of the same and of other objects, before anything was seen.
COSINE_VARIANCE = 0.04  # squared cosine
COSINE_SAMPLES = 30.0  # samples that this counts for
LEAST_COSINE_VARIANCE = 0.004  # squared cosine
COSINE_DECAY = 0.999  # what a unit of weight leaves of the past
TAILS = 3.0  # degrees of freedom of cosines, of one object and of two
CLASS_SAMPLES = 20.0  # samples that those of all classes count for in those of one
# How looks and backgrounds tell.
# How a lead in looks tells, in log odds of looks.
CHANCE_LEAD = 2.5  # a wrong object may lead by this much by chance
LEAD_BEST = 2.0  # most evidence of a lead
LEAD_LOOKS = -1.0  # looks with which nothing leads; one more, and a lead counts in full
LEAD_RIVALS = 2  # known objects of the class that it must lead at least
SAME_CLASS = -1.5  # class names that agree worse are of other classes, log odds
RING_SLOPE = 6.667  # log odds per cosine of the background
RING_MIDDLE = 0.4  # cosine that says nothing
RING_BEST = 2.0  # limit of this evidence to both sides before weighting, log odds
# How a place tells.
PLACE_LOST = 2.0  # spread at which half of the belief in a place is gone, length
PLACE_SIZE_ERROR = 0.3  # spread of a place per size of the mask
ELSEWHERE = -0.25  # log odds of an object that is elsewhere
FREE_RIVALS = 4.0  # candidates beyond which rivals cost something
# What moves of its own.
MOBILE_BEST = 8.0  # most evidence of its looks, log odds
MOBILE_RIVALS = 1.0  # share by which its rivals cost more
# Standard deviation of a relation beyond `layout.near_error`, object sizes.
RATE_ERROR = 0.2  # per distance in sizes
BORDER_ERROR = 0.7  # where a mask touches the border


@pytree
class OwnEvidence:
    """Evidence that an object has alone, in log odds, kind by kind; kinds add up."""

    looks: Float[Array, "N X"]
    lead: Float[Array, "N X"]  # it looks far more like it than like all others of its class
    background: Float[Array, "N X"]
    place: Float[Array, "N X"]
    class_name: Float[Array, "N X"]
    mobile: Float[Array, "N X"]  # what moves of its own needs no place
    rivals: Float[Array, "N X"]  # the more it could be, the less each is likely
    held: Float[Array, "N X"]  # its tracklet was missed and may resume

    @classmethod
    def kinds(cls) -> tuple[str, ...]:
        """Names of all kinds, as they are shown, in this order."""
        return tuple(field.name for field in dataclasses.fields(cls))

    def total(self) -> Float[Array, "N X"]:
        """Log odds of all of it, added up in their order."""
        return functools.reduce(operator.add, vars(self).values())


@pytree
class Evidence(OwnEvidence):
    """All evidence of a candidate: with what the others in view say."""

    layout: Float[Array, "N X"]
    companions: Float[Array, "N X"]
    moved: Float[Array, "N X"]  # given back to what lies wrong, as it may have been moved


@pytree
class Shortlist:
    """The best objects for each row, before the others in view are asked."""

    slot: Int[Array, "N C"]  # object slot
    valid: Bool[Array, "N C"]
    base: Float[Array, "N C"]  # log odds of the evidence that it has alone
    cosine: Float[Array, "N C"]  # best cosine of looks
    evidence: OwnEvidence  # what is in these log odds


def leaves_object(tracklets: Tracklets, t: th.Decision) -> Bool[Array, "T"]:
    """Tracklets not decided yet, last taken for a new object, that leave one once they end.

    Without a memory of them, what they showed would get another identity at its next sight.
    """
    long_enough = (t.ended_age > 0) & (tracklets.age >= t.ended_age)
    return tracklets.is_open & tracklets.leans_new & long_enough


def find_ended(tracklets: Tracklets, elapsed: Float[Array, ""], t: th.Decision) -> Bool[Array, "T"]:
    """Tracklets that leave an object (`leaves_object`), and can hardly resume.

    Their objects are known before anything is decided that began once they were missed.

    Args:
      elapsed: Ticks since the last frame.
    """
    waited = tracklets.unseen * share_in_deciding(elapsed) / tick_of(elapsed)
    least = jnp.minimum(MISSED_TICKS, t.commit_age - 1.0 - SLACK)
    return leaves_object(tracklets, t) & ~tracklets.just_seen & (waited >= least)


def best_cosine(white_look: Float[Array, "N E"], objects: Objects) -> Float[Array, "N O"]:
    """Cosine to the nearest kept look of each object; -1 without any."""

    def compare(rows_of: Callable[[Array], Array]) -> Float[Array, "B N"]:
        # The many kept looks first: the other way around, all of them would be transposed.
        white = rows_of(objects.white_bank)
        cosine = jnp.einsum("oke,ne->okn", white, white_look, precision="highest")
        kept = rows_of(objects.bank_count)[..., None] > 0
        return jnp.max(jnp.where(kept, cosine, -1.0), axis=1)

    nothing = jnp.full((len(objects.id), len(white_look)), -1.0, white_look.dtype)
    return fill_blocks(compare, objects.exists, nothing, OBJECTS_BLOCK).T


class Cosines(NamedTuple):
    """Cosines of looks: first of other objects, then of the same one."""

    mean: Float[Array, "2 *any"]
    variance: Float[Array, "2 *any"]


def calibrate(scene: Scene, t: th.Calibration) -> Cosines:
    """What cosines are like in this scene.

    Rule: method_plus.md#calibration.
    """
    seen = jnp.stack([scene.cosine_weight, scene.cosine_sum, scene.cosine_squares])
    assumed = Cosines(jnp.stack([t.other_mean, t.same_mean]), jnp.full(2, COSINE_VARIANCE))
    # What was assumed fades like what was seen.
    return _learn_from(seen, assumed, COSINE_SAMPLES * scene.faded, t)


def calibrate_class(scene: Scene, class_id: Int[Array, "X"], t: th.Calibration) -> Cosines:
    """What cosines are like in each of these classes: as in the scene until much is seen of it."""
    assumed = jax.tree.map(lambda leaf: leaf[:, None], calibrate(scene, t))
    return _learn_from(scene.class_cosines[..., name_row(class_id)], assumed, CLASS_SAMPLES, t)


def _learn_from(
    seen: Float[Array, "3 2 *any"],
    assumed: Cosines,
    samples: Float[Array, "2"] | float,
    t: th.Calibration,
) -> Cosines:
    """By weight, sum and sum of squares of what was seen, and as many samples of the assumed."""
    mean, variance = assumed
    weight, once, squares = seen
    weight = weight + samples
    found = (once + samples * mean) / weight
    squared = squares + samples * (variance + mean**2)
    spread = jnp.maximum(squared / weight - found**2, LEAST_COSINE_VARIANCE)
    return Cosines(jnp.where(t.enabled, found, mean), jnp.where(t.enabled, spread, variance))


def mix(squared: Array, variance: Array, lost: float, doubt: Array | float, bonus: float) -> Array:
    """Log odds of a displacement: where expected, or anywhere in the frame.

    Args:
      squared: Squared displacement.
      variance: Of each coordinate, if the object is where it is expected.
      lost: Standard deviation at which the expectation is believed by half.
      doubt: Least chance that the object is elsewhere.
      bonus: Log odds of an object that is elsewhere.
    """
    elsewhere = jnp.clip(variance / (variance + lost**2), doubt, 1.0)
    density = th.FRAME_AREA / (2 * math.pi * variance)
    density *= jnp.exp(-jnp.minimum(squared / (2 * variance), _EXPONENT_MAX))
    return jnp.log((1 - elsewhere) * density + elsewhere * jnp.exp(bonus))


def relation_error(
    relation: Float[Array, "*pairs 2"],
    spread: Float[Array, "*pairs"],
    border: Bool[Array, "*#pairs"],
    t: th.Layout,
) -> Float[Array, "*pairs"]:
    """Standard deviation of how one object lies from another, in sizes.

    Rule: method_plus.md#layout-evidence.
    """
    error = t.near_error + RATE_ERROR * jnp.sqrt(squared_length(relation))
    return error + spread + BORDER_ERROR * border


def shortlist(
    here: Tracklets,
    sightings: Sightings,
    admitted: Bool[Array, "N O"],
    waiting: Bool[Array, "O"],
    cosine: Float[Array, "N O"],
    names: Float[Array, "N O"],
    objects: Objects,
    pairs: Pairs,
    scene: Scene,
    t: th.PlusThresholds,
) -> Shortlist:
    """Adds up the evidence of each pair and keeps the best objects of each row.

    `waiting`: objects whose tracklet was missed and may resume.
    """
    moves = mobility(objects.speed, t.mobility)
    looks = _look_evidence(cosine, here.class_id, moves, scene, t)
    waited = here.duration >= t.decision.commit_age - SLACK
    evidence = OwnEvidence(
        looks=looks,
        lead=jnp.where(waited[:, None], _lead_evidence(looks, names, objects.exists), 0.0),
        background=_ring_evidence(here, objects, scene, t.looks) * (1.0 - moves),
        place=_place_evidence(sightings, objects, pairs, t.place),
        class_name=names,
        mobile=jnp.broadcast_to(t.mobility.gain * moves, admitted.shape),
        rivals=_crowd_evidence(admitted, names, t.decision)[:, None]
        * (1.0 + MOBILE_RIVALS * moves),
        held=jnp.broadcast_to(jnp.where(waiting, -t.decision.held, 0.0)[None], admitted.shape),
    )
    ranked = jnp.where(admitted, evidence.total(), -jnp.inf)
    value, slot = jax.lax.top_k(ranked, min(NUM_CANDIDATES, ranked.shape[1]))
    lacking = ((0, 0), (0, NUM_CANDIDATES - value.shape[1]))  # a memory may have fewer slots
    value, slot = jnp.pad(value, lacking, constant_values=-jnp.inf), jnp.pad(slot, lacking)
    valid = jnp.isfinite(value)
    return Shortlist(
        slot=slot,
        valid=valid,
        base=jnp.where(valid, value, 0.0),
        cosine=look_up_in_rows(cosine, slot),
        evidence=jax.tree.map(lambda one: look_up_in_rows(one, slot), evidence),
    )


def look_odds_of(
    cosine: Float[Array, "X Y"], class_id: Int[Array, "X"], scene: Scene, t: th.PlusThresholds
) -> Float[Array, "X Y"]:
    """Log odds that two looks of this cosine are of one object of a class."""
    return _look_odds(cosine, calibrate_class(scene, class_id, t.calibration), t.looks)


def _look_odds(cosine: Float[Array, "X Y"], usual: Cosines, t: th.Looks) -> Float[Array, "X Y"]:
    other, same = usual.mean[..., None]
    slope = t.gain * (same - other) / jnp.mean(usual.variance, axis=0)[:, None]
    return slope * (cosine - (same + other) / 2)


def _look_evidence(
    cosine: Float[Array, "N O"],
    class_id: Int[Array, "N"],
    moves: Float[Array, "O"],
    scene: Scene,
    t: th.PlusThresholds,
) -> Float[Array, "N O"]:
    """What looks say: within limits, beyond which they are clear (method_plus.md#clear-looks)."""
    usual = calibrate_class(scene, class_id, t.calibration)
    (other, same), (of_other, of_same) = usual.mean[..., None], usual.variance[..., None]
    # By what no other object looks like, or this one never does.
    best = log_tail(jnp.maximum(cosine - other, 0.0), of_other)
    worst = -log_tail(jnp.maximum(same - jnp.maximum(cosine, other), 0.0), of_same)
    best = jnp.maximum(best, t.looks.best + moves * (MOBILE_BEST - t.looks.best))
    return jnp.clip(_look_odds(cosine, usual, t.looks), jnp.minimum(worst, t.looks.worst), best)


def log_tail(offset: Float[Array, "X Y"], variance: Float[Array, "*any"]) -> Float[Array, "X Y"]:
    """By how much less likely cosines are than their mean, log odds: far tails, of Student's."""
    return (TAILS + 1.0) / 2.0 * jnp.log1p(offset**2 / (TAILS * variance))


def _lead_evidence(
    looks: Float[Array, "N O"], names: Float[Array, "N O"], exists: Bool[Array, "O"]
) -> Float[Array, "N O"]:
    """Evidence for the best of a class, by how far it leads the next one, free or not.

    Rule: method_plus.md#lead.
    """
    comparable = exists & (names > SAME_CLASS)
    of_class = jnp.where(comparable, looks, -jnp.inf)
    best = jnp.max(of_class, axis=1, keepdims=True)
    is_best = jnp.arange(len(exists)) == largest(of_class)[1][:, None]
    second = jnp.max(jnp.where(is_best, -jnp.inf, of_class), axis=1, keepdims=True)
    enough = jnp.sum(comparable, axis=1, keepdims=True) > LEAD_RIVALS
    lead = jnp.where(enough, best - second, 0.0)
    share = jnp.clip(best - LEAD_LOOKS, 0.0, 1.0)
    return jnp.where(is_best, share * jnp.clip(lead - CHANCE_LEAD, 0.0, LEAD_BEST), 0.0)


def _ring_evidence(
    here: Tracklets, objects: Objects, scene: Scene, t: th.Looks
) -> Float[Array, "N O"]:
    rings = to_unit(jnp.concatenate([here.ring, objects.ring]) - scene.ring_mean)
    cosine = dot(rings[: len(here.ring)], rings[len(here.ring) :])
    odds = jnp.clip(RING_SLOPE * (cosine - RING_MIDDLE), -RING_BEST, RING_BEST)
    known = (here.ring_count[:, None] > 0) & (objects.ring_count[None] > 0)
    return jnp.where(known, t.ring_weight * odds, 0.0)


def _place_evidence(
    sightings: Sightings, objects: Objects, pairs: Pairs, t: th.Place
) -> Float[Array, "N O"]:
    offset = sightings.center[:, None] - objects.position[None]
    own = diagonal(pairs.covariance)[None]
    measured = center_variance(sightings.size, sightings.touches)
    measured += (PLACE_SIZE_ERROR * sightings.size) ** 2
    squared = squared_length(offset)
    variance = own + measured[:, None]
    odds = mix(squared, variance, PLACE_LOST, t.least_doubt, ELSEWHERE)
    return t.weight * odds


def _crowd_evidence(
    admitted: Bool[Array, "N O"], names: Float[Array, "N O"], t: th.Decision
) -> Float[Array, "N"]:
    """The more objects it could be, the easier one of them looks right by chance."""
    num = jnp.sum(admitted * jnp.exp(names), axis=1)
    return -t.crowd * jnp.log(jnp.maximum(num, FREE_RIVALS) / FREE_RIVALS)
