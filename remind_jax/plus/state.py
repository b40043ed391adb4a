"""The memory of REMIND plus as one fixed-capacity pytree.

Letters: `O` object slots, `K` kept looks per object, `D` feature dimension, `E` directions that
looks are compared in, `T` tracklets (those of this frame's `N` detections first), `C` candidates,
`F` frames from one renewal of the whitening to the next.
Lengths are in frame units. Ids, never slots, are shown outside.
"""

from __future__ import annotations

import dataclasses
import enum
import functools
from typing import cast

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from remind_jax.decision import Decisions, Overflow, no_decisions
from remind_jax.numerics.absent import NO_ID, NO_SLOT
from remind_jax.numerics.columns import Column, Table
from remind_jax.numerics.constant_arrays import eye, full, zeros
from remind_jax.plus.static import (
    BANK_SLOTS,
    NUM_CANDIDATES,
    REFRESH_FRAMES,
    num_tracklets,
    white_dim,
)
from remind_jax.static import Static

UNRELATED = 1000.0  # spread of a relation that is not known
NOTHING_KNOWN = np.array([0, 0, UNRELATED, 0], np.float32)  # `Pairs.lies` of no relation
NO_RELATION = UNRELATED / 10  # from this spread on nothing is known
LONG_AGO = -1_000_000  # a frame before all others
SUMMED = -1.0  # `Scene.recent_fade` of a frame that is in the scatters
# Kinds of evidence: those that a candidate has alone, those that it has from what else is in view,
# and what is given back to one that may have been moved. Together they are its log odds.
PARTS = (
    "looks", "background", "place", "mobile", "rivals", "held", "layout", "companions", "moved"
)  # fmt: skip
NUM_OWN_PARTS = 6  # the first of them


class Stage(enum.IntEnum):
    """How far a tracklet is decided when a frame begins."""

    NONE = 0  # no detection
    OPEN = 1  # not decided yet
    FRESH = 2  # decided as new, may still turn out to be known
    SETTLED = 3


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Objects(Table):
    """One row per remembered object."""

    wholes: Int[Array, "O 6"]
    place: Float[Array, "O 4"]  # center in the present frame, visible or not, size and speed
    bank: Float[Array, "O K D"]  # kept looks
    bank_count: Int[Array, "O K"]  # sights in each, 0: free
    white_bank: Float[Array, "O K E"]  # the same, whitened, of unit length
    ring: Float[Array, "O D"]  # mean background

    id = Column("wholes")  # -1 in free slots
    class_id = Column("wholes")
    seen = Column("wholes")  # frames in which it was seen and decided
    last = Column("wholes")  # the last of them
    ring_count = Column("wholes")
    visits = Column("wholes")  # times that it was decided

    @property
    def position(self) -> Float[Array, "O 2"]:
        """Centers in the present frame, visible or not."""
        return self.place[:, :2]

    @property
    def size(self) -> Float[Array, "O"]:
        """Square roots of the areas of their masks."""
        return self.place[:, 2]

    @property
    def speed(self) -> Float[Array, "O"]:
        """Length of their own movement per frame, 0 at rest."""
        return self.place[:, 3]

    @property
    def exists(self) -> Bool[Array, "O"]:
        """Slots in use."""
        return self.id != NO_ID

    def moved(self, position: Float[Array, "O 2"]) -> Objects:
        """With other positions."""
        place = jnp.concatenate([position, self.place[:, 2:]], axis=1)
        return dataclasses.replace(self, place=place)

    def sped(self, speed: Float[Array, "O"]) -> Objects:
        """With other speeds."""
        place = jnp.concatenate([self.place[:, :3], speed[:, None]], axis=1)
        return dataclasses.replace(self, place=place)


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Pairs(Table):
    """What is known of every two objects."""

    covariance: Float[Array, "O O"]  # of the errors of their positions, x and y alike
    covisible: Float[Array, "O O"]  # frames in which both were seen
    lies: Float[Array, "O O 4"]  # how the second lies from the first

    # In geometric mean sizes, and the standard deviation of that; UNRELATED: not known
    right = Column("lies")
    down = Column("lies")
    spread = Column("lies")
    log_ratio = Column("lies")  # logarithm of size of the first by size of the second

    @property
    def relation(self) -> Float[Array, "O O 2"]:
        """From the first to the second."""
        return self.lies[..., :2]


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Tracklets(Table):
    """Uninterrupted sights of something, carried along with the image."""

    wholes: Int[Array, "T 12"]
    place: Float[Array, "T 11"]  # box, center, size, own movement, that of the image, and belief
    looks: Float[Array, "T 3 D"]

    alive = Column("wholes", truth=True)
    class_id = Column("wholes")
    last = Column("wholes")  # frame
    age = Column("wholes")  # detections so far
    ring_count = Column("wholes")
    slot = Column("wholes")  # its object once decided, NO_SLOT while open
    fresh = Column("wholes", truth=True)  # decided as new, may still turn out to be known
    num_moves = Column("wholes")  # movements that its own movement averages
    touched = Column("wholes", truth=True)  # the border of the frame when last seen
    named = Column("wholes", truth=True)  # its own id was shown before
    leans_new = Column("wholes", truth=True)  # last taken for a new object
    id = Column("wholes")  # what it would be called as a new object

    @property
    def box(self) -> Float[Array, "T 4"]:
        """Left, top, right, bottom."""
        return self.place[:, :4]

    @property
    def center(self) -> Float[Array, "T 2"]:
        """Of the mask."""
        return self.place[:, 4:6]

    @property
    def size(self) -> Float[Array, "T"]:
        """Square root of the area of the mask."""
        return self.place[:, 6]

    @property
    def drift(self) -> Float[Array, "T 2"]:
        """Own movement per frame, smoothed."""
        return self.place[:, 7:9]

    @property
    def image_shift(self) -> Float[Array, "T"]:
        """How far the image moved per frame meanwhile."""
        return self.place[:, 9]

    @property
    def belief(self) -> Float[Array, "T"]:
        """Probability of its object when it was decided."""
        return self.place[:, 10]

    def believed(self, belief: Float[Array, "T"]) -> Tracklets:
        """With other beliefs."""
        place = jnp.concatenate([self.place[:, :10], belief[:, None]], axis=1)
        return dataclasses.replace(self, place=place)

    @property
    def look(self) -> Float[Array, "T D"]:
        """Smoothed looks."""
        return self.looks[:, 0]

    @property
    def ring(self) -> Float[Array, "T D"]:
        """Smoothed backgrounds."""
        return self.looks[:, 1]

    @property
    def first_look(self) -> Float[Array, "T D"]:
        """The looks that they began with."""
        return self.looks[:, 2]

    @property
    def is_open(self) -> Bool[Array, "T"]:
        """Not decided yet."""
        return self.alive & (self.slot == NO_SLOT)


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Scene(Table):
    """What was learned about all objects together."""

    means: Float[Array, "2 D"]  # of looks and of backgrounds
    weights: Float[Array, "4"]
    total: Float[Array, "D D"]  # scatter of looks about the mean
    within: Float[Array, "D D"]  # scatter of looks within tracklets
    # Of both, the vectors of the last frames, and what each of these frames leaves of the sums
    # before it; SUMMED: the frame is in them.
    recent: Float[Array, "2 F N D"]
    recent_fade: Float[Array, "2 F"]
    basis: Float[Array, "D E"]  # orthonormal, main directions of the total scatter
    whitener: Float[Array, "E D"]
    white_mean: Float[Array, "D"]  # subtracted before whitening
    cosines: Float[Array, "2 3"]  # of other and of the same objects: weight, sum, sum of squares
    speed: Float[Array, ""]  # mean own movement per frame of the objects in view lately
    familiarity: Float[Array, ""]  # how often the last decisions were "new", [0, 1]; 0.5 at first
    faded: Float[Array, "2"]  # how much is left of what was assumed about cosines, [0, 1]

    num_looks = Column("weights")  # in their mean
    num_rings = Column("weights")
    total_weight = Column("weights")  # looks in the scatter
    within_weight = Column("weights")

    @property
    def mean(self) -> Float[Array, "D"]:
        """Of looks."""
        return self.means[0]

    @property
    def ring_mean(self) -> Float[Array, "D"]:
        """Of backgrounds."""
        return self.means[1]


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Verdicts(Table):
    """What the decisions of the last frame were made of, beyond `Decisions`."""

    owners_id: Int[Array, "N 3"]
    wholes: Int[Array, "N 3"]
    reals: Float[Array, "N 3"]
    option_id: Int[Array, "N C"]  # objects that were weighed, -1 padding
    option_reals: Float[Array, "N C 11"]

    # [N]
    tracklet_id = Column("owners_id")  # names the tracklet; the id of its object if that is new
    answer_id = Column("owners_id")  # best answer now, decided or not
    merged_id = Column("owners_id")  # object that just now turned out to be the answer, -1 none
    stage = Column("wholes")  # Stage
    age = Column("wholes")  # detections of the tracklet so far, with this one
    is_decided = Column("wholes", truth=True)
    probability = Column("reals")  # of the answer before calibration, [0, 1]
    margin = Column("reals")  # log odds to the next best answer; 0 where nothing is open
    new_odds = Column("reals")  # log odds of being no known object
    # [N C]
    option_odds = Column("option_reals")  # log odds in the end
    option_belief = Column("option_reals")  # probability beside all others and a new object

    @property
    def option_parts(self) -> Float[Array, "*frames N C 9"]:
        """Of `PARTS` in the log odds."""
        return self.option_reals[..., 2:]


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class PlusState:
    """Everything that one frame hands to the next, and the decisions of the last frame."""

    objects: Objects
    pairs: Pairs
    tracklets: Tracklets
    scene: Scene
    next_id: Int[Array, ""]
    frame: Int[Array, ""]  # frames processed so far
    decisions: Decisions
    verdicts: Verdicts
    overflow: Overflow


def init(static: Static) -> PlusState:
    """The empty memory with the capacities of `static`; `feature_dim` must be known."""
    num_o, num_k, dim = static.num_objects, BANK_SLOTS, static.feature_dim
    white = white_dim(static)

    def whole(*shape: int, value: int = 0) -> Array:
        return full(shape, value, np.int32)

    def real(*shape: int, value: float = 0.0) -> Array:
        return full(shape, value, np.float32)

    empty = PlusState(
        objects=Objects.of(
            id=whole(num_o, value=NO_ID),
            class_id=whole(num_o, value=NO_ID),
            seen=whole(num_o),
            last=whole(num_o, value=LONG_AGO),
            ring_count=whole(num_o),
            visits=whole(num_o),
            place=full((num_o, 4), (0, 0, 1, 0), np.float32),
            bank=real(num_o, num_k, dim),
            bank_count=whole(num_o, num_k),
            white_bank=real(num_o, num_k, white),
            ring=real(num_o, dim),
        ),
        pairs=Pairs(
            covariance=real(num_o, num_o),
            covisible=real(num_o, num_o),
            lies=full((num_o, num_o, 4), NOTHING_KNOWN.tolist(), np.float32),
        ),
        tracklets=no_tracklets(num_tracklets(static), dim),
        scene=Scene(
            means=real(2, dim),
            weights=real(4),
            total=real(dim, dim),
            within=real(dim, dim),
            recent=real(2, REFRESH_FRAMES, static.num_detections, dim),
            recent_fade=real(2, REFRESH_FRAMES, value=SUMMED),
            basis=cast(Array, _any_basis(dim, white)),
            whitener=eye(white, dim),
            white_mean=real(dim),
            cosines=real(2, 3),
            speed=real(),
            familiarity=real(value=0.5),
            faded=real(2, value=1.0),
        ),
        next_id=whole(),
        frame=whole(),
        decisions=no_decisions(static),
        verdicts=no_verdicts(static.num_detections),
        overflow=Overflow(objects=whole(), pending=whole()),
    )
    return jax.device_put(empty)


@functools.cache
def _any_basis(dim: int, num: int) -> Float[np.ndarray, "D E"]:
    """Directions to start from; the same on every device."""
    drawn = np.random.default_rng(0).normal(size=(dim, num))
    return np.asarray(np.linalg.qr(drawn)[0], np.float32)


def no_tracklets(num: int, dim: int) -> Tracklets:
    """`num` free places."""
    return Tracklets.of(
        alive=zeros(num, bool),
        class_id=full(num, NO_ID, np.int32),
        last=full(num, LONG_AGO, np.int32),
        age=zeros(num, np.int32),
        ring_count=zeros(num, np.int32),
        slot=full(num, NO_SLOT, np.int32),
        fresh=zeros(num, bool),
        num_moves=zeros(num, np.int32),
        touched=zeros(num, bool),
        named=zeros(num, bool),
        leans_new=zeros(num, bool),
        id=full(num, NO_ID, np.int32),
        place=full((num, 11), (0, 0, 0, 0, 0, 0, 1, 0, 0, 0, 0), np.float32),
        looks=zeros((num, 3, dim), np.float32),
    )


def no_verdicts(num: int) -> Verdicts:
    """Verdicts about no detection at all."""
    shown = (num, NUM_CANDIDATES)
    return Verdicts.of(
        tracklet_id=full(num, NO_ID, np.int32),
        answer_id=full(num, NO_ID, np.int32),
        merged_id=full(num, NO_ID, np.int32),
        stage=zeros(num, np.int32),
        age=zeros(num, np.int32),
        is_decided=zeros(num, bool),
        probability=zeros(num, np.float32),
        margin=zeros(num, np.float32),
        new_odds=zeros(num, np.float32),
        option_id=full(shown, NO_ID, np.int32),
        option_reals=zeros((*shown, 2 + len(PARTS)), np.float32),
    )
