"""The memory of REMIND plus as one fixed-capacity pytree.

Letters: `O` object slots, `K` kept looks per object, `D` feature dimension, `E` directions that
looks are compared in, `T` tracklets (those of this frame's `N` detections first), `F` frames from
one renewal of the whitening to the next, `L` rows of classes, `S` one of all and such rows.
Lengths are in frame units. Ids, never slots, are shown outside.
"""

from __future__ import annotations

import dataclasses
import functools
import re
from collections.abc import Mapping
from typing import Any, TypeVar, cast

import jax
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from remind_jax.decision import Decisions, Overflow, no_decisions
from remind_jax.numerics.absent import NO_ID, NO_SLOT
from remind_jax.numerics.constant_arrays import eye, full, number
from remind_jax.numerics.pytree import pytree
from remind_jax.plus.one_thread import on_one_thread
from remind_jax.plus.static import (
    BANK_SLOTS,
    CLASS_ROWS,
    NAME_ROWS,
    REFRESH_FRAMES,
    num_tracklets,
    white_dim,
)
from remind_jax.static import Static

T = TypeVar("T")
_TYPES = {"Bool": np.bool_, "Int": np.int32, "Float": np.float32}  # of arrays annotated so

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
    # Cosines of looks, of one object in two frames and of two objects in one: their weight, sum,
    # and sum of squares.
    links: Float[Array, "3"]
    apart: Float[Array, "3"]
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
    dim, num, white = static.feature_dim, static.num_objects, white_dim(static)
    objects = blank(
        Objects,
        {"O": num, "K": BANK_SLOTS, "D": dim, "E": white},
        id=NO_ID,
        class_id=NO_ID,
        last=LONG_AGO,
        size=1.0,
    )
    sizes = {"D": dim, "E": white, "F": REFRESH_FRAMES, "N": static.num_detections}
    scene = blank(
        Scene,
        {**sizes, "L": NAME_ROWS, "S": 1 + CLASS_ROWS},
        looks_fade=SUMMED,
        steps_fade=SUMMED,
        faded=1.0,
        newness=0.5,
    )
    basis = cast(Array, _any_basis(dim, white))
    empty = PlusState(
        objects=objects,
        pairs=blank(Pairs, {"O": num}, spread=UNRELATED),
        tracklets=no_tracklets(num_tracklets(static), dim),
        scene=dataclasses.replace(scene, basis=basis, whitener=eye(white, dim)),
        next_id=number(static.first_object_id),
        frame=number(0),
        ticks=number(0),
        phase=full((), 0.0, np.float32),
        decisions=no_decisions(static),
        answers=blank(Answers, sizes, tracklet_id=NO_ID, answer_id=NO_ID),
        overflow=Overflow(objects=number(0), pending=number(0)),
    )
    return jax.device_put(empty)


def no_tracklets(num: int, dim: int) -> Tracklets:
    """`num` free places."""
    return blank(
        Tracklets,
        {"T": num, "D": dim},
        id=NO_ID,
        class_id=NO_ID,
        last_class=NO_ID,
        slot=NO_SLOT,
        last=LONG_AGO,
        size=1.0,
        met_id=NO_ID,
        trust=1.0,
    )


def blank(record: type[T], sizes: Mapping[str, int], **values: Any) -> T:
    """A record of arrays of one value each, in the types and shapes that its annotations say.

    Args:
      record: Its class; fields are annotated as `Float[Array, "O 2"]`, by letters and numbers.
      sizes: What the letters stand for.
      **values: Of fields that are not 0 by name; or what a field is, if that is no number.
    """
    fields: Any = record
    leaves = dict(values)
    for field in dataclasses.fields(fields):
        value = values.get(field.name, 0)
        if isinstance(value, (int, float)):
            kind, _, *axes = re.findall(r"\w+", str(field.type))
            shape = [sizes[axis] if axis in sizes else int(axis) for axis in axes]
            leaves[field.name] = full(tuple(shape), value, _TYPES[kind])
    return record(**leaves)


@functools.cache
@on_one_thread
def _any_basis(dim: int, num: int) -> Float[np.ndarray, "D E"]:
    """Directions to start from; the same on every device."""
    drawn = np.random.default_rng(0).normal(size=(dim, num))
    return np.asarray(np.linalg.qr(drawn)[0], np.float32)
