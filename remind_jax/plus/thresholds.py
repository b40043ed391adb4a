"""`PlusThresholds`: every number of REMIND plus as one pytree of traced scalars.

Lengths are in *frame units*: a frame of any size has the area `FRAME_AREA`, so that a unit is 100
pixels of a frame of 640x480. Evidence is in log odds. A weight of 0 switches a part off; all parts
are independent switches. How values were chosen: docs/plus.md; what they do: docs/method_plus.md.
"""

from __future__ import annotations

import dataclasses

import jax
import jax.numpy as jnp

from remind_jax.numerics.kinds import Gate, Real, Whole

FRAME_AREA = 30.72  # units^2


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Linking:
    """Detections to tracklets, frame to frame.

    Rules: method_plus.md#linking, method_plus.md#tracklets.
    """

    overlap: Real = 3.0  # gain per intersection over union
    distance: Real = 0.6  # loss per relative distance
    distance_max: Real = 4.0  # relative distances count up to here
    slack: Real = 0.12  # length added to the scale of distances per frame unseen
    look: Real = 1.5  # gain per cosine
    look_middle: Real = 0.4  # cosine that says nothing
    size: Real = 0.5  # loss per log ratio of sizes
    least: Real = -2.0  # links score more than this
    smoothing: Whole = 4  # the look of a tracklet averages about this many frames


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Motion:
    """Whether to believe the image motion, and how places move with it.

    Rules: method_plus.md#motion-check, method_plus.md#map-motion.
    """

    doubted_score: Real = 0.1  # at this score the motion is not believed at all
    trusted_score: Real = 0.4  # and from here on fully
    shift_error: Real = 0.02  # standard deviation of the shift per frame
    shift_error_rate: Real = 0.04  # more of it per unit moved
    shift_error_lost: Real = 0.25  # more of it where the motion is not believed
    turn_error: Real = 0.004  # standard deviation of turn and zoom per frame
    turn_error_lost: Real = 4.0  # factor above 1 where the motion is not believed
    own_error: Real = 0.003  # standard deviation of each object apart, per frame
    own_error_rate: Real = 0.006  # more of it per unit moved
    reach: Real = 30.0  # places further from the centre turn as if they were this far
    checked: Gate = True  # disbelieve a motion that the detections contradict
    check_margin: Real = 0.5  # support per detection by which they must do so
    agreement: Real = 0.3  # shifts of detections within this length agree
    agreement_least: Real = 3.0  # detections that must agree on a shift
    implied_score: Real = 0.25  # trust in a shift that they agree on
    coupled: Gate = True  # errors of places are shared


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Place:
    """Evidence from where an object should be, and correction of the map.

    Rules: method_plus.md#evidence, method_plus.md#place-correction.
    """

    weight: Real = 0.8
    lost: Real = 2.0  # spread at which half of the belief in a place is gone
    least_doubt: Real = 0.02  # chance that an object is not where it should be
    doubt_bonus: Real = -0.25  # log odds of an object that is elsewhere
    center_error: Real = 0.06  # standard deviation of a measured centre
    center_error_rate: Real = 0.15  # more of it per size of the mask
    center_error_border: Real = 0.25  # more of it at the border of the frame
    size_error: Real = 0.3  # spread of the place per size of the mask
    surprise: Real = 8.0  # median squared innovation above which the map was wrong


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Looks:
    """Evidence from appearance and background.

    Rules: method_plus.md#whitening, method_plus.md#evidence.
    """

    whitening: Gate = True  # compare along the scatter within tracklets
    prior_samples: Real = 30.0  # weight of the assumed scatter within tracklets
    prior_share: Real = 0.1  # assumed scatter within tracklets as part of the total
    prior_round: Real = 0.7  # part of it that is equal in all directions
    ridge: Real = 0.1  # of the mean variance, added in all directions
    total_share: Real = 0.02  # of the total scatter that is added
    scatter_decay: Real = 0.9995  # per sample
    mean_samples: Real = 3000.0  # running means forget beyond this many
    gain: Real = 0.8  # log odds per calibrated log odd
    worst: Real = -5.0
    best: Real = 3.0
    sure_patches: Real = 2.0  # sides of a mask in patches from which on looks count in full
    least_weight: Real = 0.25  # of smaller masks
    ring_weight: Real = 0.3
    ring_slope: Real = 6.667  # per cosine
    ring_middle: Real = 0.4  # cosine that says nothing
    ring_best: Real = 2.0  # limit of the evidence to both sides before weighting
    unit_patches: Gate = True  # scale every patch feature to unit length first


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Calibration:
    """What cosines of the same and of other objects look like in this scene.

    Rule: method_plus.md#calibration.
    """

    enabled: Gate = True
    same_mean: Real = 0.6  # before anything was seen
    other_mean: Real = 0.1
    variance: Real = 0.04
    samples: Real = 30.0  # weight of these
    least_variance: Real = 0.004
    decay: Real = 0.999  # per unit of weight
    min_age: Whole = 8  # detections of a tracklet that teaches
    every: Whole = 2  # frames
    same_weight: Real = 0.5  # of now and first sight of a tracklet
    other_weight: Real = 0.5  # of other objects of the class in view
    foreign_weight: Real = 0.1  # of objects of other classes in view
    sure_weight: Real = 2.0  # of a clearly recognised object
    sure_margin: Real = 3.0


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Layout:
    """Evidence from what else is in view, and how it lies.

    Rules: method_plus.md#layout-evidence, method_plus.md#joint-weighing.
    """

    weight: Real = 0.8  # of the relative layout
    best: Real = 6.0  # limit of the layout evidence to both sides before weighting
    moved: Real = -3.0  # log odds of an object that lies where it should not, place included
    moved_gone: Real = -0.5  # the same if its old place is seen to be empty
    gone_anchors: Whole = 3  # decided objects that tell where the old place is
    gone_error: Real = 1.5  # greatest standard deviation of that, per size of the object
    partners: Real = 6.0  # that speak in full; more share this
    witness: Real = 0.5  # an open partner speaks by half if its looks say minus this ...
    witness_slope: Real = 2.0  # ... and by less, or more, this fast
    near_error: Real = 0.6  # standard deviation of a relation in sizes
    rate_error: Real = 0.2  # more of it per distance in sizes
    border_error: Real = 0.7  # more of it where a mask touches the border
    lost: Real = 1.2  # spread at which half of the belief in a relation is gone
    least_doubt: Real = 0.05
    pair_best: Real = 3.0  # limit of the evidence of one partner
    ratio_weight: Real = 0.5  # of the ratio of sizes
    ratio_error: Real = 0.4
    ratio_error_border: Real = 0.8
    rounds: Whole = 5  # of weighing all open tracklets of a frame together
    optimism: Real = 4.0  # log odds that a new object loses in the first round of weighing
    covisible_weight: Real = 0.6
    covisible_partners: Real = 2.0
    covisible_typical: Real = 0.15  # share of frames that two objects share by chance
    covisible_best: Real = 1.5
    near: Real = 2.56  # length over which absence of a companion tells something
    spread_max: Real = 4.0  # relations that are less certain are not stored
    spread_slack: Real = 0.02  # a relation may be this much less certain than the stored one
    spread_same: Real = 0.1  # relations of about the same certainty are averaged
    rate: Real = 0.3  # with this weight of the new one


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Decision:
    """Known or new, now or later (method_plus.md#novelty, method_plus.md#decision)."""

    new: Real = 1.0  # log odds of a new object
    familiarity: Real = 0.8  # weight of how much was new of what came last and is in view
    familiarity_rate: Real = 0.2  # of one decision
    familiarity_least: Real = 0.1
    familiarity_open: Real = 1.0  # weight of an open tracklet in it, in decisions
    crowd: Real = 0.7  # loss per log of the number of candidates
    crowd_free: Real = 4.0  # candidates without a loss
    firm: Real = 0.5  # least probability of an answer that is given before it is decided
    possible: Real = 0.1  # least probability of what else it could be
    commit_age: Whole = 8  # detections after which a tracklet is decided
    early_age: Whole = 2  # a clear win is decided from here on
    early_margin: Real = 4.0
    tentative: Real = 0.5  # log odds that a new object loses until then
    late_frames: Whole = 60  # detections for which a new object may turn out to be known
    late_margin: Real = 3.0  # more than `new` that this takes
    late_seen: Real = 0.5  # and the known one must have been seen this many times as long
    ended_age: Whole = 2  # one that ends undecided as new is remembered from here on; 0: never
    held: Real = 3.0  # loss of an object whose tracklet was missed and may resume


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Confidence:
    """How often answers are right: at belief 0 and at belief 1, linear between (docs/plus.md).

    The belief is that of the evidence; what it does not know of, it cannot doubt.
    """

    open_known: Real = 0.32  # not decided yet, a known object
    open_known_sure: Real = 0.97
    open_new: Real = 0.38  # not decided yet, a new object
    open_new_sure: Real = 0.85
    known: Real = 0.54  # decided, a known object
    known_sure: Real = 0.99
    new: Real = 0.80  # decided, a new object
    new_sure: Real = 0.97


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Memory:
    """What is kept of an object (method_plus.md#look-learning)."""

    novel: Real = 0.8  # a look is added where no kept one is closer
    rate_samples: Real = 12.0  # kept looks average about this many
    every: Whole = 2  # detections
    border_age: Whole = 3  # later looks at the border are not kept


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class PlusThresholds:
    """All tunable numbers of REMIND plus."""

    linking: Linking = dataclasses.field(default_factory=Linking)
    motion: Motion = dataclasses.field(default_factory=Motion)
    place: Place = dataclasses.field(default_factory=Place)
    looks: Looks = dataclasses.field(default_factory=Looks)
    calibration: Calibration = dataclasses.field(default_factory=Calibration)
    layout: Layout = dataclasses.field(default_factory=Layout)
    decision: Decision = dataclasses.field(default_factory=Decision)
    memory: Memory = dataclasses.field(default_factory=Memory)
    confidence: Confidence = dataclasses.field(default_factory=Confidence)

    def as_arrays(self) -> PlusThresholds:
        """The same numbers as arrays, so that arithmetic never falls back to Python's."""

        def convert(value: object) -> jax.Array:
            array = jnp.asarray(value)
            if jnp.issubdtype(array.dtype, jnp.floating):
                return array.astype(jnp.float32)
            if jnp.issubdtype(array.dtype, jnp.integer):
                return array.astype(jnp.int32)
            return array

        return jax.tree.map(convert, self)
