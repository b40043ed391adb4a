"""What the stages of a step found about each detection, beyond what every method decides."""

from __future__ import annotations

import enum

from jaxtyping import Array, Bool, Float, Int

from remind_jax.numerics.pytree import pytree


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


@pytree
class Stages:
    """By detection; `C` are the candidates of its `Decisions`."""

    status_final: Int[Array, "N"]  # Status of the final scores of eligible candidates
    num_close: Int[Array, "N"]  # candidates within `close_delta` of the best
    is_anchor: Bool[Array, "N"]  # clear enough to speak for its surroundings
    lock: Int[Array, "N"]  # Lock
    assigned_id: Int[Array, "N"]  # object after locks and joint assignment; -1 new
    guarded_id: Int[Array, "N"]  # object after the guard of look-alikes, -1 none
    source: Int[Array, "N"]  # MatchOrigin
    candidate_gate: Int[Array, "N C"]  # association.gating.Gate
    candidate_bonus: Float[Array, "N C"]  # context adjustment that was applied
