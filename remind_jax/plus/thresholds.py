"""`PlusThresholds`: every number of REMIND plus as one pytree of traced scalars.

Lengths are in *frame units*: a frame of any size has the area `FRAME_AREA`, so that a unit is 100
pixels of a frame of 640x480. Evidence is in log odds. A weight of 0 switches a part off; all parts
are independent switches. How values were chosen: docs/plus.md; what they do: docs/method_plus.md.
"""

from __future__ import annotations

import dataclasses

import jax

from remind_jax.settings.arrays import AsArrays
from remind_jax.settings.kinds import Gate, Real, Whole
from remind_jax.settings.record import setting

FRAME_AREA = 30.72  # units^2

# fmt: off


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Linking:
    """Detections to tracklets, frame to frame.

    Rules: method_plus.md#linking, method_plus.md#tracklets.
    """

    overlap: Real = setting(3.0, "gain per intersection over union", "log odds")
    distance: Real = setting(0.6, "loss per relative distance", "log odds")
    distance_max: Real = setting(4.0, "relative distances count up to here", "relative distance")
    slack: Real = setting(0.12, "length added to the scale of distances per tick unseen", "length")
    look: Real = setting(1.5, "gain per cosine", "log odds")
    look_middle: Real = setting(0.4, "cosine that says nothing", "cosine")
    unlike: Real = setting(1.5,
        "most loss by looks that contradict, where the image motion is believed", "log odds")
    missed: Real = setting(1.5, "loss of what moves, per doubling of the ticks since it was seen",
        "log odds")
    size: Real = setting(0.5, "loss per log ratio of sizes", "log odds")
    samples: Real = setting(10.0, "weight of what is assumed of looks of one object in two frames",
        "samples")
    least: Real = setting(-2.0, "links score more than this", "log odds")
    smoothing: Whole = setting(4, "the look of a tracklet averages about this many frames",
        "frames")


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Motion:
    """Whether to believe the image motion, and how places move with it.

    Rules: method_plus.md#motion-check, method_plus.md#map-motion.
    """

    doubted_score: Real = setting(0.1, "at this score the motion is not believed at all", "score")
    trusted_score: Real = setting(0.4, "and from here on fully", "score")
    shift_error: Real = setting(0.02, "standard deviation of the shift per frame", "length")
    shift_error_rate: Real = setting(0.04, "more of it per unit moved", "share")
    shift_error_lost: Real = setting(0.25, "more of it where the motion is not believed", "length")
    turn_error: Real = setting(0.004, "standard deviation of turn and zoom per frame", "radians")
    turn_error_lost: Real = setting(4.0, "factor above 1 where the motion is not believed",
        "factor")
    own_error: Real = setting(0.003, "standard deviation of each object apart, per frame", "length")
    own_error_rate: Real = setting(0.006, "more of it per unit moved", "share")
    reach: Real = setting(30.0, "places further from the center turn as if they were this far",
        "length")
    checked: Gate = setting(True, "disbelieve a motion that the detections contradict")
    check_margin: Real = setting(0.5, "support per detection by which they must do so", "support")
    agreement: Real = setting(0.3, "shifts of detections within this length agree", "length")
    agreement_least: Real = setting(3.0, "detections that must agree on a shift", "detections")
    implied_score: Real = setting(0.25, "trust in a shift that they agree on", "trust")
    coupled: Gate = setting(True, "errors of places are shared")


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Mobility:
    """Which objects move of their own, and what follows from it.

    Rule: method_plus.md#own-movement.
    """

    weight: Real = setting(1.0, "of the speeds of objects; 0: nothing moves of its own", "weight")
    noise: Real = setting(0.01, "own movement per frame that things at rest seem to have", "length")
    noise_rate: Real = setting(0.4, "more of it, per length that the image moves", "share")
    samples: Whole = setting(16, "the own movement of a tracklet averages about so long", "ticks")
    least: Whole = setting(3, "and counts from then on", "ticks")
    memory: Real = setting(32.0, "frames that the speed of an object averages", "frames")
    prior: Real = setting(4.0, "weight of the speed of the scene in that of a new object",
        "frames")
    rate: Real = setting(0.05, "what a frame changes of the speed of the scene", "share")
    half: Real = setting(0.02, "speed of an object that is by half one that moves", "length")
    best: Real = setting(8.0, "most evidence of looks of an object that moves", "log odds")
    gain: Real = setting(0.4, "log odds of an object that moves, in place of those of its place",
        "log odds")
    crowd: Real = setting(1.0, "more of the loss by `decision.crowd` for an object that moves",
        "share")
    forgetting: Real = setting(2.0, "errors of places and relations grow by this times the speed",
        "factor")


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Place:
    """Evidence from where an object should be, and correction of the map.

    Rules: method_plus.md#evidence, method_plus.md#place-correction.
    """

    weight: Real = setting(0.8, "of the place in the evidence", "weight")
    lost: Real = setting(2.0, "spread at which half of the belief in a place is gone", "length")
    least_doubt: Real = setting(0.02, "chance that an object is not where it should be",
        "probability")
    doubt_bonus: Real = setting(-0.25, "log odds of an object that is elsewhere", "log odds")
    center_error: Real = setting(0.06, "standard deviation of a measured center", "length")
    center_error_rate: Real = setting(0.15, "more of it per size of the mask", "share")
    center_error_border: Real = setting(0.25, "more of it at the border of the frame", "length")
    size_error: Real = setting(0.3, "spread of the place per size of the mask", "share")
    surprise: Real = setting(8.0, "median squared innovation above which the map was wrong",
        "variances")


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Looks:
    """Evidence from appearance and background.

    Rules: method_plus.md#whitening, method_plus.md#evidence.
    """

    whitening: Gate = setting(True, "compare along the scatter within tracklets")
    prior_samples: Real = setting(30.0, "weight of the assumed scatter within tracklets", "samples")
    prior_share: Real = setting(0.1, "assumed scatter within tracklets as part of the total",
        "share")
    prior_round: Real = setting(0.7, "part of it that is equal in all directions", "share")
    ridge: Real = setting(0.1, "of the mean variance, added in all directions", "share")
    total_share: Real = setting(0.02, "share of the total scatter that is added", "share")
    teaches: Real = setting(16.0, "detections of an object that teach in full", "detections")
    scatter_decay: Real = setting(0.9995, "what each sample leaves of the scatter so far", "factor")
    mean_samples: Real = setting(3000.0, "running means forget beyond this many", "samples")
    gain: Real = setting(0.8, "log odds per calibrated log odd", "factor")
    worst: Real = setting(-5.0, "least evidence of looks", "log odds")
    best: Real = setting(3.0, "most evidence of looks", "log odds")
    sure_patches: Real = setting(2.0,
        "sides of a mask in patches from which on looks count in full", "patches")
    least_weight: Real = setting(0.25, "of looks of smaller masks", "weight")
    ring_weight: Real = setting(0.3, "of the background in the evidence", "weight")
    ring_slope: Real = setting(6.667, "gain per cosine of the background", "log odds")
    ring_middle: Real = setting(0.4, "cosine that says nothing", "cosine")
    ring_best: Real = setting(2.0, "limit of the evidence to both sides before weighting",
        "log odds")
    unit_patches: Gate = setting(True, "scale every patch feature to unit length first")


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Names:
    """What class names say (method_plus.md#class-names)."""

    confused: Real = setting(0.1, "chance of another name for one thing before any was seen",
        "probability")
    samples: Real = setting(20.0, "weight of what is assumed before", "detections")


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Calibration:
    """What cosines of the same and of other objects look like in this scene.

    Rule: method_plus.md#calibration.
    """

    enabled: Gate = setting(True, "learn it from the scene; off: as assumed below")
    same_mean: Real = setting(0.6, "mean of the same object before anything was seen", "cosine")
    other_mean: Real = setting(0.1, "mean of other objects before anything was seen", "cosine")
    variance: Real = setting(0.04, "variance of both before anything was seen", "squared cosine")
    samples: Real = setting(30.0, "weight of what is assumed before anything was seen", "samples")
    least_variance: Real = setting(0.004, "least variance of either", "squared cosine")
    decay: Real = setting(0.999, "what a unit of weight leaves of the past", "factor")
    min_age: Whole = setting(8, "detections of a tracklet that teaches", "detections")
    every: Whole = setting(2, "calibrated once in so many frames", "frames")
    same_weight: Real = setting(0.5, "of now and first sight of a tracklet", "weight")
    other_weight: Real = setting(0.5, "of other objects of the class in view", "weight")
    absent_weight: Real = setting(0.5, "of other known objects of the class", "weight")
    absent_most: Real = setting(5.0, "of which so many count", "objects")
    foreign_weight: Real = setting(0.1, "of objects of other classes in view", "weight")
    sure_weight: Real = setting(2.0, "of a clearly recognized object", "weight")
    sure_margin: Real = setting(3.0, "lead of a clearly recognized object", "log odds")


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Layout:
    """Evidence from what else is in view, and how it lies.

    Rules: method_plus.md#layout-evidence, method_plus.md#joint-weighing.
    """

    weight: Real = setting(0.8, "of the relative layout", "weight")
    best: Real = setting(6.0, "limit of the layout evidence to both sides before weighting",
        "log odds")
    moved: Real = setting(-3.0,
        "log odds of an object that lies where it should not, place included", "log odds")
    most: Real = setting(5.0, "most place and layout together", "log odds")
    moved_gone: Real = setting(-0.5, "the same if its old place is seen to be empty", "log odds")
    gone_anchors: Whole = setting(3, "decided objects that tell where the old place is", "objects")
    gone_error: Real = setting(1.5, "greatest standard deviation of that, per size of the object",
        "object sizes")
    partners: Real = setting(6.0, "partners that speak in full; more share this", "objects")
    witness: Real = setting(0.5, "an open partner speaks by half if its looks say minus this ...",
        "log odds")
    witness_slope: Real = setting(2.0, "... and by less, or more, this fast", "per log odd")
    witness_class: Real = setting(1.0,
        "what a partner's class adds to its looks, per log of how rare it is among known objects",
        "factor")
    near_error: Real = setting(0.6, "standard deviation of a relation in sizes", "object sizes")
    rate_error: Real = setting(0.2, "more of it per distance in sizes", "share")
    border_error: Real = setting(0.7, "more of it where a mask touches the border", "object sizes")
    lost: Real = setting(1.2, "spread at which half of the belief in a relation is gone",
        "object sizes")
    least_doubt: Real = setting(0.05, "chance that a relation no longer holds", "probability")
    pair_best: Real = setting(3.0, "limit of the evidence of one partner", "log odds")
    ratio_weight: Real = setting(0.5, "of the ratio of sizes", "weight")
    ratio_spread: Real = setting(1.0, "spread of a relation that tells half as much of sizes",
        "object sizes")
    ratio_error: Real = setting(0.4, "standard deviation of the ratio of sizes", "log ratio")
    ratio_error_border: Real = setting(0.8, "more of it where a mask touches the border",
        "log ratio")
    rounds: Whole = setting(5, "of weighing all open tracklets of a frame together", "rounds")
    optimism: Real = setting(4.0, "log odds that a new object loses in the first round of weighing",
        "log odds")
    covisible_weight: Real = setting(0.4, "of what is seen together", "weight")
    covisible_partners: Real = setting(2.0, "partners that speak in full; more share this",
        "objects")
    covisible_typical: Real = setting(0.15, "share of frames that two objects share by chance",
        "share")
    covisible_best: Real = setting(1.5, "limit of the evidence of what is seen together",
        "log odds")
    near: Real = setting(2.56, "length over which absence of a companion tells something", "length")
    spread_max: Real = setting(4.0, "relations that are less certain are not stored",
        "object sizes")
    spread_slack: Real = setting(0.02,
        "a relation may be this much less certain than the stored one", "object sizes")
    spread_same: Real = setting(0.1, "relations of about the same certainty are averaged",
        "object sizes")
    rate: Real = setting(0.3, "with this weight of the new one", "share")


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Decision:
    """Known or new, now or later (method_plus.md#novelty, method_plus.md#decision)."""

    new: Real = setting(0.8, "log odds of a new object", "log odds")
    familiarity: Real = setting(1.0, "weight of how much was new of what came last and is in view",
        "weight")
    familiarity_rate: Real = setting(0.2, "what one decision changes of it", "share")
    familiarity_least: Real = setting(0.1, "least share of new objects that is assumed", "share")
    familiarity_open: Real = setting(1.0, "weight of an open tracklet in it, in decisions",
        "decisions")
    crowd: Real = setting(0.7, "loss per log of the number of candidates", "log odds")
    crowd_free: Real = setting(4.0, "candidates without a loss", "candidates")
    firm: Real = setting(0.5, "least probability of an answer that is given before it is decided",
        "probability")
    firm_small: Real = setting(0.75, "the same for a small new object", "probability")
    small: Real = setting(0.24, "size of a mask below which it is small", "length")
    possible: Real = setting(0.1, "least probability of what else it could be", "probability")
    commit_age: Whole = setting(8, "time in view after which a tracklet is decided", "ticks")
    early_age: Whole = setting(2, "a clear win is decided from here on", "detections")
    early_margin: Real = setting(4.0, "lead that is a clear win", "log odds")
    tentative: Real = setting(1.5, "log odds that a new object loses until then", "log odds")
    tentative_border: Real = setting(1.0, "more of it for what the border of the frame cuts off",
        "log odds")
    late_frames: Whole = setting(60, "detections for which a new object may turn out to be known",
        "detections")
    late_margin: Real = setting(2.0, "more than `new` that this takes", "log odds")
    late_seen: Real = setting(0.5, "and the known one must have been seen this many times as long",
        "factor")
    ended_age: Whole = setting(2,
        "one that ends undecided as new is remembered from here on; 0: never", "detections")
    held: Real = setting(3.0, "loss of an object whose tracklet was missed and may resume",
        "log odds")


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Confidence:
    """How often answers are right, at least and at most belief (method_plus.md#answers).

    The belief is that of the evidence; what it does not know of, it cannot doubt.
    """

    open_known: Real = setting(0.046, "open, a known object: at belief 0.001", "probability")
    open_known_sure: Real = setting(0.981, "the same at belief 0.999", "probability")
    open_new: Real = setting(0.19, "open, a new object: at belief 0.001", "probability")
    open_new_sure: Real = setting(0.942, "the same at belief 0.999", "probability")
    known: Real = setting(0.0113, "decided, a known object: at belief 0.001", "probability")
    known_sure: Real = setting(0.9985, "the same at belief 0.999", "probability")
    new: Real = setting(0.5615, "decided, a new object: at belief 0.001", "probability")
    new_sure: Real = setting(0.9811, "the same at belief 0.999", "probability")
    moving: Real = setting(0.6, "what belief loses once decided, if the object moves", "share")


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Memory:
    """What is kept of an object (method_plus.md#look-learning)."""

    novel: Real = setting(0.8, "a look is added where no kept one is closer", "cosine")
    rate_samples: Real = setting(12.0, "kept looks average about this many", "samples")
    every: Whole = setting(2, "a look is learned once in so many detections", "detections")
    border_age: Whole = setting(8, "later looks at the border are not kept", "detections")


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class PlusThresholds(AsArrays):
    """All tunable numbers of REMIND plus."""

    linking: Linking = dataclasses.field(default_factory=Linking)
    motion: Motion = dataclasses.field(default_factory=Motion)
    mobility: Mobility = dataclasses.field(default_factory=Mobility)
    place: Place = dataclasses.field(default_factory=Place)
    looks: Looks = dataclasses.field(default_factory=Looks)
    names: Names = dataclasses.field(default_factory=Names)
    calibration: Calibration = dataclasses.field(default_factory=Calibration)
    layout: Layout = dataclasses.field(default_factory=Layout)
    decision: Decision = dataclasses.field(default_factory=Decision)
    memory: Memory = dataclasses.field(default_factory=Memory)
    confidence: Confidence = dataclasses.field(default_factory=Confidence)
