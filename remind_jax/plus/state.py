"""The memory of REMIND plus as one fixed-capacity pytree.

Letters: `O` object slots, `K` kept looks per object, `D` feature dimension, `E` directions that
looks are compared in, `T` tracklets (those of this frame's `N` detections first), `F` frames from
one renewal of the whitening to the next, `L` rows of classes.
Lengths are in frame units. Ids, never slots, are shown outside.
"""

from __future__ import annotations

import dataclasses
import functools
from typing import cast

import jax
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from remind_jax.decision import Decisions, Overflow, no_decisions
from remind_jax.numerics.absent import NO_ID, NO_SLOT
from remind_jax.numerics.constant_arrays import eye, full, zeros
from remind_jax.numerics.pytree import pytree
from remind_jax.plus.static import (
    BANK_SLOTS,
    CLASS_ROWS,
    NAME_ROWS,
    REFRESH_FRAMES,
    num_tracklets,
    white_dim,
)
from remind_jax.static import Static

UNRELATED = 1000.0  # spread of a relation that is not known
NO_RELATION = UNRELATED / 10  # from this spread on nothing is known
LONG_AGO = -1_000_000  # a frame before all others
SUMMED = -1.0  # `Scene.looks_fade` and `Scene.steps_fade` of a frame that is in the scatters


@pytree
class Objects:
    """One row per remembered object."""

    id: Int[Array, "O"]  # -1 in free slots
    class_id: Int[Array, "O"]
    class_lead: Int[Array, "O"]  # detections by which that class leads
    seen: Int[Array, "O"]  # frames in which it was seen and decided
    last: Int[Array, "O"]  # the last of them
    visits: Int[Array, "O"]  # tracklets that were decided to be it
    position: Float[Array, "O 2"]  # center in the present frame, visible or not
    size: Float[Array, "O"]  # square root of the area of the mask
    speed: Float[Array, "O"]  # length of the own movement per tick, 0 at rest
    bank: Float[Array, "O K D"]  # kept looks
    bank_count: Int[Array, "O K"]  # sights in each, 0: free
    white_bank: Float[Array, "O K E"]  # the same, whitened, of unit length
    ring: Float[Array, "O D"]  # mean background
    ring_count: Int[Array, "O"]  # sights in it

    @property
    def exists(self) -> Bool[Array, "O"]:
        """Slots in use."""
        return self.id != NO_ID


@pytree
class Pairs:
    """What is known of every two objects."""

    covariance: Float[Array, "O O"]  # of the errors of their positions, x and y alike
    covisible: Float[Array, "O O"]  # frames in which both were seen
    # How the second lies from the first, in geometric mean sizes, and the standard deviation of
    # that: UNRELATED where it is not known.
    relation: Float[Array, "O O 2"]
    spread: Float[Array, "O O"]
    log_ratio: Float[Array, "O O"]  # logarithm of size of the first by size of the second


@pytree
class Tracklets:
    """Uninterrupted sights of something, carried along with the image."""

    alive: Bool[Array, "T"]
    id: Int[Array, "T"]  # what it would be called as a new object
    class_id: Int[Array, "T"]
    class_lead: Int[Array, "T"]  # detections by which that class leads
    last_class: Int[Array, "T"]  # of the last detection
    slot: Int[Array, "T"]  # its object once decided, NO_SLOT while open
    last: Int[Array, "T"]  # frame
    unseen: Float[Array, "T"]  # ticks since then
    age: Int[Array, "T"]  # detections that count so far
    duration: Float[Array, "T"]  # ticks in view, one for the first detection
    box: Float[Array, "T 4"]  # left, top, right, bottom
    center: Float[Array, "T 2"]  # of the mask
    size: Float[Array, "T"]  # square root of the area of the mask
    touched: Bool[Array, "T"]  # the border of the frame when last seen
    drift: Float[Array, "T 2"]  # own movement per tick, smoothed
    course: Float[Array, "T 2"]  # middle of its box, had it gone on as when it last stood apart
    pace: Float[Array, "T 2"]  # own movement per tick by its last detections then
    met: Float[Array, "T"]  # ticks since; 0: it stands apart
    met_id: Int[Array, "T"]  # the tracklet that it met last, NO_ID: none
    num_moves: Float[Array, "T"]  # ticks that it averages
    image_shift: Float[Array, "T"]  # how far the image moved per tick meanwhile
    look: Float[Array, "T D"]  # smoothed
    first_look: Float[Array, "T D"]  # the look that it began with
    ring: Float[Array, "T D"]  # background, smoothed
    ring_count: Int[Array, "T"]  # detections with a background
    belief: Float[Array, "T"]  # probability of its object
    trust: Float[Array, "T"]  # probability that it passed to nothing else since it was decided
    fresh: Bool[Array, "T"]  # decided as new
    named: Bool[Array, "T"]  # its own id was shown before
    leans_new: Bool[Array, "T"]  # last taken for a new object

    @property
    def is_open(self) -> Bool[Array, "T"]:
        """Not decided yet."""
        return self.alive & (self.slot == NO_SLOT)

    @property
    def just_seen(self) -> Bool[Array, "T"]:
        """In the last frame."""
        return self.unseen == 0


@pytree
class Scene:
    """What was learned about all objects together."""

    mean: Float[Array, "D"]  # of looks
    num_looks: Float[Array, ""]  # in their mean
    ring_mean: Float[Array, "D"]  # of backgrounds
    num_rings: Float[Array, ""]
    total: Float[Array, "D D"]  # scatter of looks about the means of their classes
    total_weight: Float[Array, ""]  # looks in it
    within: Float[Array, "D D"]  # scatter of looks within tracklets
    within_weight: Float[Array, ""]
    # Of both scatters, the vectors of the last frames, and what each of these frames leaves of the
    # sums before it; SUMMED: the frame is in them.
    recent_looks: Float[Array, "F N D"]
    looks_fade: Float[Array, "F"]
    recent_steps: Float[Array, "F N D"]
    steps_fade: Float[Array, "F"]
    basis: Float[Array, "D E"]  # orthonormal, main directions of the total scatter
    whitener: Float[Array, "E D"]
    white_mean: Float[Array, "D"]  # subtracted before whitening
    raised: Float[Array, ""]  # cosine of two objects about it, [0, 1); nothing where it is of many
    class_offset: Float[Array, "L D"]  # by which looks of a class differ from it
    # Cosines so far, first of other objects, then of the same, and how much is left of what was
    # assumed about them, [0, 1].
    cosine_weight: Float[Array, "2"]
    cosine_sum: Float[Array, "2"]
    cosine_squares: Float[Array, "2"]
    faded: Float[Array, "2"]
    class_cosines: Float[Array, "3 2 L"]  # weights, sums and sums of squares, class by class
    # Cosines of looks of one object in two frames: their weight, sum, and sum of squares.
    links: Float[Array, "3"]
    names: Float[Array, "L L"]  # times that a tracklet of one class went on as another
    speed: Float[Array, ""]  # mean own movement per tick of the objects in view lately
    # How often the last decisions were "new", [0, 1], and how much of that was seen, [0, 1]: of all
    # objects, and class by class.
    newness: Float[Array, "S"]
    newness_known: Float[Array, "S"]


@pytree
class Answers:
    """What the last frame's detections were taken for; decided or not."""

    tracklet_id: Int[Array, "N"]  # names the tracklet; the id of its object if that is new
    answer_id: Int[Array, "N"]  # best answer now


@pytree
class PlusState:
    """Everything that one frame hands to the next, and the decisions of the last frame."""

    objects: Objects
    pairs: Pairs
    tracklets: Tracklets
    scene: Scene
    next_id: Int[Array, ""]
    frame: Int[Array, ""]  # frames processed so far
    ticks: Int[Array, ""]  # of the clock so far
    phase: Float[Array, ""]  # part of a tick that has passed since the last one
    decisions: Decisions
    answers: Answers
    overflow: Overflow


def init(static: Static) -> PlusState:
    """The empty memory with the capacities of `static`; `feature_dim` must be known."""
    empty = PlusState(
        objects=_no_objects(static),
        pairs=_no_pairs(static.num_objects),
        tracklets=no_tracklets(num_tracklets(static), static.feature_dim),
        scene=_unknown_scene(static),
        next_id=_whole(value=static.first_object_id),
        frame=_whole(),
        ticks=_whole(),
        phase=_real(),
        decisions=no_decisions(static),
        answers=_no_answers(static.num_detections),
        overflow=Overflow(objects=_whole(), pending=_whole()),
    )
    return jax.device_put(empty)


def _whole(*shape: int, value: int = 0) -> Array:
    return full(shape, value, np.int32)


def _real(*shape: int, value: float = 0.0) -> Array:
    return full(shape, value, np.float32)


def _no_objects(static: Static) -> Objects:
    num, kept, dim = static.num_objects, BANK_SLOTS, static.feature_dim
    return Objects(
        id=_whole(num, value=NO_ID),
        class_id=_whole(num, value=NO_ID),
        class_lead=_whole(num),
        seen=_whole(num),
        last=_whole(num, value=LONG_AGO),
        visits=_whole(num),
        position=_real(num, 2),
        size=_real(num, value=1.0),
        speed=_real(num),
        bank=_real(num, kept, dim),
        bank_count=_whole(num, kept),
        white_bank=_real(num, kept, white_dim(static)),
        ring=_real(num, dim),
        ring_count=_whole(num),
    )


def _no_pairs(num: int) -> Pairs:
    return Pairs(
        covariance=_real(num, num),
        covisible=_real(num, num),
        relation=_real(num, num, 2),
        spread=_real(num, num, value=UNRELATED),
        log_ratio=_real(num, num),
    )


def no_tracklets(num: int, dim: int) -> Tracklets:
    """`num` free places."""
    return Tracklets(
        alive=zeros(num, bool),
        id=_whole(num, value=NO_ID),
        class_id=_whole(num, value=NO_ID),
        class_lead=_whole(num),
        last_class=_whole(num, value=NO_ID),
        slot=_whole(num, value=NO_SLOT),
        last=_whole(num, value=LONG_AGO),
        unseen=_real(num),
        age=_whole(num),
        duration=_real(num),
        box=_real(num, 4),
        center=_real(num, 2),
        size=_real(num, value=1.0),
        touched=zeros(num, bool),
        drift=_real(num, 2),
        course=_real(num, 2),
        pace=_real(num, 2),
        met=_real(num),
        met_id=_whole(num, value=NO_ID),
        num_moves=_real(num),
        image_shift=_real(num),
        look=_real(num, dim),
        first_look=_real(num, dim),
        ring=_real(num, dim),
        ring_count=_whole(num),
        belief=_real(num),
        trust=_real(num, value=1.0),
        fresh=zeros(num, bool),
        named=zeros(num, bool),
        leans_new=zeros(num, bool),
    )


def _unknown_scene(static: Static) -> Scene:
    dim, white = static.feature_dim, white_dim(static)
    recent = REFRESH_FRAMES, static.num_detections, dim
    return Scene(
        mean=_real(dim),
        num_looks=_real(),
        ring_mean=_real(dim),
        num_rings=_real(),
        total=_real(dim, dim),
        total_weight=_real(),
        within=_real(dim, dim),
        within_weight=_real(),
        recent_looks=_real(*recent),
        looks_fade=_real(REFRESH_FRAMES, value=SUMMED),
        recent_steps=_real(*recent),
        steps_fade=_real(REFRESH_FRAMES, value=SUMMED),
        basis=cast(Array, _any_basis(dim, white)),
        whitener=eye(white, dim),
        white_mean=_real(dim),
        raised=_real(),
        class_offset=_real(NAME_ROWS, dim),
        cosine_weight=_real(2),
        cosine_sum=_real(2),
        cosine_squares=_real(2),
        faded=_real(2, value=1.0),
        class_cosines=_real(3, 2, NAME_ROWS),
        links=_real(3),
        names=_real(NAME_ROWS, NAME_ROWS),
        speed=_real(),
        newness=_real(1 + CLASS_ROWS, value=0.5),
        newness_known=_real(1 + CLASS_ROWS),
    )


@functools.cache
def _any_basis(dim: int, num: int) -> Float[np.ndarray, "D E"]:
    """Directions to start from; the same on every device."""
    drawn = np.random.default_rng(0).normal(size=(dim, num))
    return np.asarray(np.linalg.qr(drawn)[0], np.float32)


def _no_answers(num: int) -> Answers:
    return Answers(*(_whole(num, value=NO_ID) for _ in dataclasses.fields(Answers)))
