"""`Explanation`: everything that one decision was made of, ready to be printed or written as JSON.

Keys of the JSON are the field names here; absent values are null. Scores lie in [0, 1].
"""

from __future__ import annotations

import dataclasses
import enum
from collections.abc import Mapping
from typing import Any

import numpy as np

from remind_jax.decision import NO_ID, Lock, Outcome, Reason, Source, Status
from remind_jax.explanation.remind.case import Case
from remind_jax.remind.association.gating import Gate
from remind_jax.remind.context.veto import Veto
from remind_jax.remind.disambiguation.joint_assignments import GroupStatus
from remind_jax.remind.memory.objects import Lifecycle

FORMAT, VERSION = "remind-jax explanation", 1
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
    assignment_score: float  # what the joint assignment maximised
    final_score: float  # what was tested for acceptance
    held_by: int | None  # other detection that got it in the end


@dataclasses.dataclass(frozen=True)
class Quality:
    """How much could be told from the detection."""

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
    """A detection so clear that it speaks for its surroundings."""

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
    """An object whose distances told the members of a group apart."""

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


@dataclasses.dataclass(frozen=True)
class Explanation:
    """Why one detection became what it became."""

    frame: int
    time_s: float
    frame_name: str
    detection: int
    label: str
    name: str  # `mug 4`, `mug 3 or 7?`
    outcome: Outcome
    reason: Reason
    object_id: int | None
    score: float | None  # with what context added, can exceed 1; None: there is none
    confidence: float | None  # of the same
    status: Status  # of the visual scores
    status_final: Status  # of the final scores of open candidates
    best_score: float
    second_score: float
    num_close: int
    lock: Lock
    source: Source
    assigned_id: int | None  # after locks and joint assignment
    guarded_id: int | None  # after the guard of look-alikes
    why: tuple[str, ...]  # sentences, in the order of the tracker
    quality: Quality
    num_candidates: int  # in all
    candidates: tuple[Candidate, ...]  # the best of them, by falling visual score
    context: Context
    anchors: tuple[Anchor, ...]  # of the frame
    sets: tuple[ObjectSet, ...]  # of the frame, the most believable first
    known_sets: tuple[KnownSet, ...]
    pending: PendingTrack | None

    def to_json(self) -> dict[str, Any]:
        """The same as `json` can write it; codes are words."""
        head = {"format": FORMAT, "version": VERSION}
        return head | {
            field.name: to_jsonable(getattr(self, field.name)) for field in dataclasses.fields(self)
        }

    def to_text(self, width: int | None = None) -> str:
        """The same as a page of plain text, with lines of at most `width` characters if given."""
        from remind_jax.explanation.remind.text import render_text

        return render_text(self, width)

    def __str__(self) -> str:
        return self.to_text()


@dataclasses.dataclass(frozen=True)
class Circumstances:
    """What the explanation takes from the run rather than from the trace."""

    time_s: float
    frame_name: str
    name: str
    first_frame: int | None  # of the pending track
    num_detections: int  # of the pending track so far
    is_rated: bool  # whether it has a score and a confidence


def account_for(case: Case, around: Circumstances, why: tuple[str, ...]) -> Explanation:
    """Gathers the parts of an explanation."""
    record, known = case.record, case.decision
    return Explanation(
        frame=record.frame_index,
        time_s=around.time_s,
        frame_name=around.frame_name,
        detection=case.row,
        label=case.label,
        name=around.name,
        outcome=case.outcome,
        reason=case.reason,
        object_id=_id(known("object_id")),
        score=known("score") if around.is_rated else None,
        confidence=known("confidence") if around.is_rated else None,
        status=Status(known("status")),
        status_final=Status(known("status_final")),
        best_score=known("best_score"),
        second_score=known("second_score"),
        num_close=known("num_close"),
        lock=Lock(known("lock")),
        source=Source(known("source")),
        assigned_id=_id(known("assigned_id")),
        guarded_id=_id(known("guarded_id")),
        why=why,
        quality=_quality(case),
        num_candidates=case.trace("num_candidates"),
        candidates=tuple(_candidate(case, i) for i in case.candidate_ids()),
        context=Context(
            bool(record.context.enabled),
            float(record.context.quality),
            bool(record.context.usable),
        ),
        anchors=_anchors(case),
        sets=tuple(_object_set(case, place) for place in range(len(record.sets.score))),
        known_sets=tuple(
            _known_set(case, turn)
            for turn in range(case.num_passes)
            if case.passes("undecided", turn) and case.passes("status", turn) != GroupStatus.NONE
        ),
        pending=_pending(case, around),
    )


def _quality(case: Case) -> Quality:
    quality, density = case.trace("quality").tolist(), case.trace("density").tolist()
    return Quality(*quality, *density, effective_patches=case.trace("patch_sum"))


def _candidate(case: Case, object_id: int) -> Candidate:
    def take(field: str) -> Any:
        return case.candidate(object_id, field)

    sources = [SOURCES[code] for code in case.trace("source")]
    names = (*TERMS, *MORE_TERMS)[: len(sources)]
    columns = zip(names, take("value"), take("present"), take("weight"), sources, strict=True)
    return Candidate(
        object_id=object_id,
        name=case.name(object_id),
        lifecycle=Lifecycle(take("lifecycle")),
        unseen_frames=take("misses"),
        terms={
            term: Term(float(score) if present else None, float(weight), source)
            for term, score, present, weight, source in columns
        },
        authority=take("authority"),
        visual_score=take("visual"),
        comparable_score=take("comparable"),
        bonus=take("bonus"),
        bonus_raw=take("bonus_raw"),
        backed=take("supported"),
        support=take("support"),
        contradiction=take("contradiction"),
        veto=Veto(take("veto")),
        plausible=take("plausible"),
        gate=Gate(take("gate")),
        eligible=take("eligible"),
        assignment_score=take("assign"),
        final_score=take("final"),
        held_by=case.holder(object_id, "object_id"),
    )


def _anchors(case: Case) -> tuple[Anchor, ...]:
    ids = case.record.detections.anchor_id
    return tuple(
        Anchor(int(row), int(ids[row]), case.name(int(ids[row])))
        for row in np.flatnonzero(ids != NO_ID)
    )


def _object_set(case: Case, place: int) -> ObjectSet:
    sets = case.record.sets
    ids, explained = case.record.set_members[place]
    mine, decided = case.candidate_ids(), case.decision("object_id")
    is_known = case.outcome == Outcome.MATCH
    return ObjectSet(
        score=float(sets.score[place]),
        coverage=float(sets.coverage[place]),
        density=float(sets.density[place]),
        maturity=float(sets.maturity[place]),
        object_ids=ids,
        names=tuple(case.name(i) for i in ids),
        detections=explained,
        candidates=tuple(i for i in ids if i in mine),
        agrees=decided in ids if is_known else None,
    )


def _known_set(case: Case, turn: int) -> KnownSet:
    def take(field: str) -> Any:
        return case.passes(field, turn)

    roots = case.record.detections.passes.root[:, turn]
    return KnownSet(
        turn=turn,
        status=GroupStatus(take("status")),
        reason=Reason(take("reason")),
        detections=tuple(int(row) for row in np.flatnonzero(roots == take("root"))),
        options=dict(case.options(turn)),
        proposed_id=_id(take("proposed_id")),
        score=take("score"),
        second=None if take("second") < 0 else take("second"),
        core=take("core"),
        core_gap=take("core_gap"),
        evidence=take("evidence"),
        voters=_voters(case, turn),
    )


def _voters(case: Case, turn: int) -> tuple[Voter, ...]:
    def take(field: str) -> Any:
        return case.passes(field, turn)

    options, usual, episodes = take("option_id"), take("remembered"), take("num_remembered")
    return tuple(
        Voter(
            object_id=int(anchor),
            name=case.name(int(anchor)),
            detection=int(take("anchor_detection")[place]),
            quality=float(take("anchor_quality")[place]),
            distance=float(take("distance")[place]),
            remembered={
                int(i): float(usual[k, place])
                for k, i in enumerate(options)
                if i != NO_ID and episodes[k, place] > 0
            },
        )
        for place, anchor in enumerate(take("anchor_id"))
        if anchor != NO_ID
    )


def _pending(case: Case, around: Circumstances) -> PendingTrack | None:
    if case.decision("pending_id") == NO_ID:
        return None
    blocked = dict(zip(case.decision("option_id"), case.decision("option_blocked"), strict=True))
    first = case.record.frame_index if around.first_frame is None else around.first_frame
    return PendingTrack(
        kind=pending_kind(case.outcome),
        track_id=case.decision("pending_id"),
        first_frame=first,
        num_detections=around.num_detections,
        options=tuple(
            Option(i, case.name(i), score, bool(blocked[i])) for i, score in case.options()
        ),
    )


def pending_kind(outcome: Outcome) -> str:
    """The kind of track that an undecided detection belongs to."""
    return "ambiguous" if outcome == Outcome.AMBIGUOUS else "provisional"


def _id(value: int) -> int | None:
    return None if value == NO_ID else value


def to_jsonable(value: Any) -> Any:
    """Nested dataclasses as `json` can write them; codes are words."""
    if dataclasses.is_dataclass(value):
        return {
            field.name: to_jsonable(getattr(value, field.name))
            for field in dataclasses.fields(value)
        }
    if isinstance(value, enum.Enum):
        return value.name.lower()
    if isinstance(value, Mapping):
        return {str(key): to_jsonable(item) for key, item in value.items()}
    if isinstance(value, (tuple, list)):
        return [to_jsonable(item) for item in value]
    if isinstance(value, float):
        return round(value, 6) if np.isfinite(value) else None
    return value
