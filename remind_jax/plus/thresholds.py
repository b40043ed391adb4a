"""`PlusThresholds`: what can be set of REMIND plus, as one pytree of traced scalars.

Lengths are in *frame units*: a frame of any size has the area `FRAME_AREA`, so that a unit is 100
pixels of a frame of 640x480. Evidence is in log odds. A weight of 0 switches a part off; all parts
are independent switches. What belongs to a rule alone is a constant of its module. How values were
chosen: docs/plus.md; what they do: docs/method_plus.md.
"""

from __future__ import annotations

import dataclasses

from remind_jax.numerics.pytree import pytree
from remind_jax.settings.arrays import AsArrays
from remind_jax.settings.kinds import Gate, Real, Whole
from remind_jax.settings.record import setting

FRAME_AREA = 30.72  # units^2

# fmt: off


@pytree
class Linking:
    """Detections to tracklets, frame to frame.

    Rules: method_plus.md#linking, method_plus.md#tracklets.
    """

    overlap: Real = setting(3.0, "gain per intersection over union", "log odds")
    distance: Real = setting(0.6, "loss per relative distance", "log odds")
    look: Real = setting(1.5, "gain per cosine", "log odds")
    missed: Real = setting(1.5, "loss of what moves, per doubling of the ticks since it was seen",
        "log odds")
    least: Real = setting(-2.0, "links score more than this", "log odds")


@pytree
class Motion:
    """Whether to believe the image motion, and how places move with it.

    Rules: method_plus.md#motion-check, method_plus.md#map-motion.
    """

    shift_error: Real = setting(0.02, "standard deviation of the shift per tick", "length")
    checked: Gate = setting(True, "disbelieve a motion that the detections contradict")


@pytree
class Mobility:
    """Which objects move of their own, and what follows from it.

    Rule: method_plus.md#own-movement.
    """

    weight: Real = setting(1.0, "of the speeds of objects; 0: nothing moves of its own", "weight")
    gain: Real = setting(0.4, "log odds of an object that moves, in place of those of its place",
        "log odds")


@pytree
class Place:
    """Evidence from where an object should be, and correction of the map.

    Rules: method_plus.md#evidence, method_plus.md#place-correction.
    """

    weight: Real = setting(0.8, "of the place in the evidence", "weight")
    least_doubt: Real = setting(0.02, "chance that an object is not where it should be",
        "probability")


@pytree
class Looks:
    """Evidence from appearance and background.

    Rules: method_plus.md#whitening, method_plus.md#evidence.
    """

    whitening: Gate = setting(True, "compare along the scatter within tracklets")
    gain: Real = setting(0.8, "log odds per calibrated log odd", "factor")
    worst: Real = setting(-5.0, "least evidence of looks that are not clear", "log odds")
    best: Real = setting(3.0, "most evidence of looks that are not clear", "log odds")
    ring_weight: Real = setting(0.3, "of the background in the evidence", "weight")
    unit_patches: Gate = setting(True, "scale every patch feature to unit length first")


@pytree
class Names:
    """What class names say (method_plus.md#class-names)."""

    confused: Real = setting(0.1, "chance of another name for one thing before any was seen",
        "probability")
    cropped: Real = setting(0.8, "intersection over union from which on boxes of two names, whole "
        "or cropped alike at one side, may show one thing; above 1: none", "share")


@pytree
class Calibration:
    """What cosines of the same and of other objects look like in this scene.

    Rule: method_plus.md#calibration.
    """

    enabled: Gate = setting(True, "learn it from the scene; off: as assumed below")
    same_mean: Real = setting(0.6, "mean of the same object before anything was seen", "cosine")
    other_mean: Real = setting(0.1, "mean of other objects before anything was seen", "cosine")


@pytree
class Layout:
    """Evidence from what else is in view, and how it lies.

    Rules: method_plus.md#layout-evidence, method_plus.md#joint-weighing.
    """

    weight: Real = setting(0.8, "of the relative layout", "weight")
    best: Real = setting(6.0, "limit of the layout evidence to both sides before weighting",
        "log odds")
    moved: Real = setting(-3.0,
        "log odds of an object that lies where it should not, place included", "log odds")
    moved_gone: Real = setting(-0.5, "the same if its old place is seen to be empty", "log odds")
    gone_anchors: Whole = setting(3, "decided objects that tell where the old place is", "objects")
    near_error: Real = setting(0.6, "standard deviation of a relation in sizes", "object sizes")
    rounds: Whole = setting(5, "of weighing all open tracklets of a frame together", "rounds")
    covisible_weight: Real = setting(0.4, "of what is seen together", "weight")


@pytree
class Decision:
    """Known or new, now or later (method_plus.md#novelty, method_plus.md#decision)."""

    new: Real = setting(0.8, "log odds of a new object", "log odds")
    familiarity: Real = setting(1.0, "weight of how much was new of what came last and is in view",
        "weight")
    familiarity_open: Real = setting(1.0, "weight of an open tracklet in it, in decisions",
        "decisions")
    crowd: Real = setting(0.7, "loss per log of the number of candidates", "log odds")
    firm: Real = setting(0.5, "least probability of an answer that is given before it is decided",
        "probability")
    firm_small: Real = setting(0.75, "the same for a small new object", "probability")
    possible: Real = setting(0.1, "least probability of what else it could be", "probability")
    commit_age: Whole = setting(8,
        "time in view after which a tracklet is decided; twice that if no answer leads", "ticks")
    early_age: Whole = setting(2, "a clear win is decided from here on", "detections")
    early_margin: Real = setting(4.0, "lead that is a clear win", "log odds")
    tentative: Real = setting(1.5, "log odds that a new object loses until then", "log odds")
    tentative_border: Real = setting(1.0, "more of it for what the border of the frame cuts off",
        "log odds")
    ended_age: Whole = setting(2,
        "one that ends undecided as new is remembered from here on; 0: never", "detections")
    held: Real = setting(3.0, "loss of an object whose tracklet was missed and may resume",
        "log odds")


@pytree
class Memory:
    """What is kept of an object (method_plus.md#look-learning)."""

    novel: Real = setting(0.8, "a look is added where no kept one is closer", "cosine")
    rate_samples: Real = setting(12.0, "kept looks average about this many", "samples")


@pytree
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
