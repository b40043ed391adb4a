"""What leaves the tracker for each detection: outcome codes and the `Decisions` of one frame."""

from __future__ import annotations

import dataclasses
import enum

import jax
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from remind_jax.numerics.columns import Column, Table
from remind_jax.numerics.constant_arrays import full, number, zeros
from remind_jax.static import Static

NO_ID = -1
NEVER = -1  # the frame of what did not happen yet
NUM_OPTIONS = 3  # objects that an undecided detection may name


class Outcome(enum.IntEnum):
    """What became of a detection (method.md#outcomes)."""

    EMPTY = 0  # padding slot, no detection
    MATCH = 1  # a known object
    NEW = 2  # the first sight of an object
    AMBIGUOUS = 3  # one of two or three known objects, undecided
    PROVISIONAL_NEW = 4  # probably new, but a known object cannot be excluded
    PROVISIONAL_PARENT = 5  # probably a known object, but not certainly
    UNASSIGNED = 6  # decided nothing and remembered nothing
    DROPPED = 7  # unusable: empty mask or no finite feature

    @property
    def is_firm(self) -> bool:
        """True if the detection has one identity now."""
        return self in (Outcome.MATCH, Outcome.NEW)


class Status(enum.IntEnum):
    """How clear the visual evidence is (method.md#status)."""

    NONE = 0
    STRONG = 1
    AMBIGUOUS = 2
    WEAK = 3


class Reason(enum.IntEnum):
    """Why a detection became what it became (method.md#outcomes)."""

    NONE = 0
    ASSIGNED = 1
    CREATED_NEW = 2
    NO_ASSIGNMENT = 3
    KNOWN_BUT_AMBIGUOUS = 4
    KNOWN_BUT_AMBIGUOUS_VISUAL = 5
    KNOWN_BUT_AMBIGUOUS_MATCH = 6
    KNOWN_BUT_AMBIGUOUS_VISUAL_MATCH = 7
    KNOWN_BUT_AMBIGUOUS_IDENTITY_STABILITY = 8
    KNOWN_AND_COMMITTED_NEW_COMPETITION = 9
    KNOWN_BUT_AMBIGUOUS_BLOCKED_FALLBACK = 10
    KNOWN_BUT_AMBIGUOUS_CONTEXTUAL_FALLBACK = 11
    UNCERTAIN_PARENT = 12
    UNCERTAIN_KNOWN_BLOCKED = 13
    UNCERTAIN_NEW_WITH_KNOWN_CONTEXT = 14
    UNCERTAIN_NEW_VISUAL_FALLBACK = 15
    UNCERTAIN_NEW = 16
    INVALID_INPUT = 17
    KNOWN_BUT_HELD_BY_BETTER_MATCH = 18
    SEEN_TOO_FEW_TIMES = 19  # it has an identity, which is not announced (yet)


class Lock(enum.IntEnum):
    """Whether a clear win settled the pair before the joint assignment (method.md#locks)."""

    NONE = 0
    OBJECT = 1
    DETECTION = 2


class MatchOrigin(enum.IntEnum):
    """What gave a match its object (method.md#settlement-rounds)."""

    NONE = 0
    ASSOCIATION = 1
    DISTANCE_FULL = 2  # the layout of a closed group of look-alikes, clearly
    DISTANCE_PARTIAL = 3  # the same, barely
    DISTANCE_FULL_POSTCREATE = 4  # the same for detections that would have been new
    DISTANCE_PARTIAL_POSTCREATE = 5


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Decisions(Table):
    """The decisions of one frame; `Decisions.of` takes each by its name.

    Letters: `N` detection slots, `C` candidates shown per detection, `K = 3` objects that an
    undecided detection could be.
    """

    owners_id: Int[Array, "N 3"]
    wholes: Int[Array, "N 9"]
    reals: Float[Array, "N 4"]
    option_id: Int[Array, "N K"]  # objects that an undecided detection could be, -1 padding
    option_score: Float[Array, "N K"]
    option_blocked: Bool[Array, "N K"]  # held by another detection
    candidate_id: Int[Array, "N C"]  # by falling score, then rising id; -1 padding
    candidate_wholes: Int[Array, "N C 3"]
    candidate_reals: Float[Array, "N C 3"]
    num_bad_patches: Int[Array, ""]  # patches of the frame with a feature that is not finite

    # [N]
    outcome = Column("wholes")  # Outcome
    reason = Column("wholes")  # Reason
    object_id = Column("owners_id")  # matched or created object, -1 without identity
    pending_id = Column("wholes")  # ambiguous or provisional track, numbered per kind; -1 none
    score = Column("reals")  # final score of the match, best score of an undecided one, 0 if new
    status = Column("wholes")  # Status of the visual scores
    status_final = Column("wholes")  # Status of the final scores of eligible candidates
    confidence = Column("reals")  # [0, 1]
    best_score = Column("reals")  # highest visual score over candidates, 0 without any
    second_score = Column("reals")  # second highest, 0 without any
    num_close = Column("wholes")  # candidates within `close_delta` of the best
    lock = Column("wholes")  # Lock
    source = Column("wholes")  # MatchOrigin
    assigned_id = Column("owners_id")  # object after locks and joint assignment; -1 new
    guarded_id = Column("owners_id")  # object after the guard of look-alikes, -1 none
    is_anchor = Column("wholes", truth=True)  # clear enough to speak for its surroundings
    # [N C]
    candidate_score = Column("candidate_reals")  # visual score
    candidate_final = Column("candidate_reals")  # score after context
    candidate_eligible = Column("candidate_wholes", truth=True)  # open to assignment
    candidate_plausible = Column("candidate_wholes", truth=True)  # not vetoed by context
    candidate_gate = Column("candidate_wholes")  # association.gating.Gate
    candidate_bonus = Column("candidate_reals")  # context adjustment that was applied


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Overflow:
    """What did not fit. A frame that overflows changes nothing else in the state."""

    objects: Int[Array, ""]  # object slots that the frame needs, 0 if they sufficed
    pending: Int[Array, ""]  # slots of pending tracks that it needs, 0 if they sufficed


def no_decisions(static: Static) -> Decisions:
    """Decisions about no detection at all."""
    num, shown, scalar = static.num_detections, static.num_candidates, static.scalar

    def whole(value: int) -> Array:
        return full(num, int(value), np.int32)

    def real() -> Array:
        """A new array at each call: buffers are donated to the step, each only once."""
        return zeros(num, scalar)

    return Decisions.of(
        outcome=whole(Outcome.EMPTY),
        reason=whole(0),
        object_id=whole(NO_ID),
        pending_id=whole(NO_ID),
        score=real(),
        status=whole(0),
        status_final=whole(0),
        confidence=real(),
        best_score=real(),
        second_score=real(),
        num_close=whole(0),
        lock=whole(0),
        source=whole(0),
        assigned_id=whole(NO_ID),
        guarded_id=whole(NO_ID),
        is_anchor=zeros(num, bool),
        option_id=full((num, NUM_OPTIONS), NO_ID, np.int32),
        option_score=zeros((num, NUM_OPTIONS), scalar),
        option_blocked=zeros((num, NUM_OPTIONS), bool),
        candidate_id=full((num, shown), NO_ID, np.int32),
        candidate_score=zeros((num, shown), scalar),
        candidate_final=zeros((num, shown), scalar),
        candidate_eligible=zeros((num, shown), bool),
        candidate_plausible=zeros((num, shown), bool),
        candidate_gate=zeros((num, shown), np.int32),
        candidate_bonus=zeros((num, shown), scalar),
        num_bad_patches=number(0),
    )
