"""What a decision of REMIND was made of: candidates, context, sets, layout, pending tracks.

Scores lie in [0, 1], those with context may exceed 1.
"""

from __future__ import annotations

import dataclasses

from remind_jax.decision import Reason
from remind_jax.remind.association.gating import Gate
from remind_jax.remind.context.veto import Veto
from remind_jax.remind.disambiguation.joint_assignments import GroupStatus
from remind_jax.remind.memory.objects import Lifecycle

TERMS = ("object", "background", "parts")
MORE_TERMS = ("ring_prototypes",)  # if they are on
SOURCES = ("auto", "work", "stable")  # banks that a term was compared with


@dataclasses.dataclass(frozen=True)
class Term:
    """One visual channel of a candidate."""

    score: float | None  # None: nothing to compare
    weight: float  # after the quality of observation and prototype
    source: str  # SOURCES


@dataclasses.dataclass(frozen=True)
class Candidate:
    """A known object that the detection was compared with."""

    object_id: int
    name: str
    lifecycle: Lifecycle  # before the frame
    unseen_frames: int
    terms: dict[str, Term]  # by TERMS, and MORE_TERMS
    authority: float  # how proven the winning prototype is
    visual_score: float  # weighted mean of the terms
    comparable_score: float  # on the evidence that all plausible candidates have, with context
    bonus: float  # from context, as applied
    bonus_raw: float  # from context, had it been allowed
    backed: bool  # clearly supported by context
    support: float  # by context
    contradiction: float  # by context
    veto: Veto
    plausible: bool  # not vetoed
    gate: Gate
    eligible: bool  # open to assignment
    assignment_score: float  # what the joint assignment maximized
    final_score: float  # what was tested for acceptance
    held_by: int | None  # other detection that got it in the end


@dataclasses.dataclass(frozen=True)
class Quality:
    """How much the detection shows."""

    object: float
    background: float
    parts: float
    object_density: float  # factor on the weight of the object, small for thin masks
    parts_density: float
    effective_patches: float


@dataclasses.dataclass(frozen=True)
class Context:
    """The context of the frame."""

    enabled: bool
    quality: float
    usable: bool  # good enough to change scores


@dataclasses.dataclass(frozen=True)
class Anchor:
    """A detection so clear that its object counts as seen when surroundings are judged."""

    detection: int
    object_id: int
    name: str


@dataclasses.dataclass(frozen=True)
class ObjectSet:
    """Objects that may be in view together."""

    score: float
    coverage: float
    density: float
    maturity: float
    object_ids: tuple[int, ...]
    names: tuple[str, ...]
    detections: tuple[int, ...]  # that they explain
    candidates: tuple[int, ...]  # of these objects, the candidates of this detection
    agrees: bool | None  # holds the object decided; None while there is none


@dataclasses.dataclass(frozen=True)
class Voter:
    """An object whose distances distinguish the members of a group."""

    object_id: int
    name: str
    detection: int
    quality: float  # how well it separates the group
    distance: float  # from the detection to it, in object sizes
    remembered: dict[int, float]  # usual distance of each object in question to it


@dataclasses.dataclass(frozen=True)
class KnownSet:
    """What layout said about a closed group in one pass of the reconciliation."""

    turn: int  # pass, from 0
    status: GroupStatus
    reason: Reason  # why the detection was undecided
    detections: tuple[int, ...]
    options: dict[int, float]  # objects that this detection could be, with scores
    proposed_id: int | None  # object of this detection in the best joint assignment
    score: float
    second: float | None  # of the runner-up
    core: float  # score without appearance
    core_gap: float
    evidence: float
    voters: tuple[Voter, ...]


@dataclasses.dataclass(frozen=True)
class Option:
    """An object that an undecided detection could be."""

    object_id: int
    name: str
    score: float
    blocked: bool  # held by another detection


@dataclasses.dataclass(frozen=True)
class PendingTrack:
    """The track of undecided detections that this one belongs to."""

    kind: str  # "ambiguous" or "provisional"
    track_id: int  # numbered per kind
    first_frame: int
    num_detections: int  # up to and with this one
    options: tuple[Option, ...]
