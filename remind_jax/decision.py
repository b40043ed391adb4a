"""What leaves the tracker for each detection: outcome codes and the `Decisions` of one frame."""

from __future__ import annotations

import enum

import numpy as np
from jaxtyping import Array, Bool, Float, Int

from remind_jax.numerics.constant_arrays import full, number, zeros
from remind_jax.numerics.pytree import pytree
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
    DROPPED = 7  # unusable: empty mask, no finite feature, or a second detection of one thing

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
    DOUBLE = 20  # another detection shows the same thing


CODES = {"outcome": Outcome, "reason": Reason, "status": Status}  # by the field that holds them


@pytree
class Decisions:
    """The decisions of one frame, whatever the method.

    Letters: `N` detection slots, `C` candidates shown per detection, `K = 3` objects that an
    undecided detection could be.
    """

    outcome: Int[Array, "N"]  # Outcome
    reason: Int[Array, "N"]  # Reason
    object_id: Int[Array, "N"]  # matched or created object, -1 without identity
    pending_id: Int[Array, "N"]  # undecided track, numbered per kind; -1 none
    score: Float[Array, "N"]  # of the match, best score of an undecided one, 0 if new
    status: Int[Array, "N"]  # Status of the visual scores
    confidence: Float[Array, "N"]  # [0, 1]
    best_score: Float[Array, "N"]  # highest score over candidates, 0 without any
    second_score: Float[Array, "N"]  # second highest, 0 without any
    option_id: Int[Array, "N K"]  # objects that an undecided detection could be, -1 padding
    option_score: Float[Array, "N K"]
    option_blocked: Bool[Array, "N K"]  # held by another detection
    candidate_id: Int[Array, "N C"]  # by falling score, then rising id; -1 padding
    candidate_score: Float[Array, "N C"]  # visual score
    candidate_final: Float[Array, "N C"]  # score after context
    candidate_eligible: Bool[Array, "N C"]  # open to assignment
    candidate_plausible: Bool[Array, "N C"]  # not vetoed by context
    num_bad_patches: Int[Array, ""]  # patches of the frame that are not usable


@pytree
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

    return Decisions(
        outcome=whole(Outcome.EMPTY),
        reason=whole(0),
        object_id=whole(NO_ID),
        pending_id=whole(NO_ID),
        score=real(),
        status=whole(0),
        confidence=real(),
        best_score=real(),
        second_score=real(),
        option_id=full((num, NUM_OPTIONS), NO_ID, np.int32),
        option_score=zeros((num, NUM_OPTIONS), scalar),
        option_blocked=zeros((num, NUM_OPTIONS), bool),
        candidate_id=full((num, shown), NO_ID, np.int32),
        candidate_score=zeros((num, shown), scalar),
        candidate_final=zeros((num, shown), scalar),
        candidate_eligible=zeros((num, shown), bool),
        candidate_plausible=zeros((num, shown), bool),
        num_bad_patches=number(0),
    )
