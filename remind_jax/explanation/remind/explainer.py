"""From the trace of the paper's tracker to explanations."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

import jax
import numpy as np

from remind_jax.decision import NO_ID, Decisions, Outcome, Reason, Status
from remind_jax.explanation.archive import TraceArchive, first_rows
from remind_jax.explanation.explainer import Explainer
from remind_jax.explanation.explanation import id_or_none
from remind_jax.explanation.remind.case import Case, FrameRecord
from remind_jax.explanation.remind.evidence import (
    MORE_TERMS,
    SOURCES,
    TERMS,
    Anchor,
    Candidate,
    Context,
    KnownSet,
    ObjectSet,
    Option,
    PendingTrack,
    Quality,
    Term,
    Voter,
)
from remind_jax.explanation.remind.explanation import RemindExplanation
from remind_jax.explanation.remind.reasons import give_reasons
from remind_jax.remind.association.gating import Gate
from remind_jax.remind.context.veto import Veto
from remind_jax.remind.disambiguation.joint_assignments import GroupStatus
from remind_jax.remind.memory.objects import Lifecycle
from remind_jax.remind.stages import Lock, MatchOrigin
from remind_jax.remind.trace import Trace
from remind_jax.tracks import Tracks

# Fields of a candidate that are in the trace under the same name.
_AS_TRACED = (
    "unseen_frames",
    "authority",
    "visual_score",
    "comparable_score",
    "bonus",
    "bonus_raw",
    "backed",
    "support",
    "contradiction",
    "plausible",
    "eligible",
    "assignment_score",
    "final_score",
)


class RemindExplainer(Explainer[FrameRecord]):
    """Explains decisions of one run."""

    RECORD = FrameRecord

    def __init__(
        self,
        archive: TraceArchive[FrameRecord],
        tracks: Sequence[Tracks],
        config: Mapping[str, Any],
    ) -> None:
        super().__init__(archive, tracks, config)
        self._pending = _follow_pending(tracks)

    @staticmethod
    def record(num: int, decisions: Decisions, trace: Trace) -> FrameRecord:
        """What is kept of a frame."""
        sets = jax.tree.map(lambda leaf: leaf[trace.sets.valid], trace.sets)
        # A set explains as many detections as it has members.
        sets = dataclasses.replace(
            sets, detections=sets.detections[:, :num], member_id=sets.member_id[:, :num]
        )
        decided, stages, known = first_rows((decisions, trace.stages, trace.detections), num)
        return FrameRecord(decided, stages, known, sets, trace.context)

    def _explain(self, record: FrameRecord, tracks: Tracks, row: int) -> RemindExplanation:
        labels = self._archive.labels
        case = Case(record, row, tracks.labels[row], labels, tracks.names, self._config)
        since = self._pending.get((tracks.frame_index, row))
        is_rated, found, made = tracks.is_rated(row), case.decision, case.stage
        return RemindExplanation(
            frame=tracks.frame_index,
            time_s=float(tracks.time_s),
            frame_name=tracks.name,
            detection=row,
            label=case.label,
            name=_name(case),
            outcome=case.outcome,
            reason=case.reason,
            object_id=id_or_none(found("object_id")),
            decided_at=None if found("object_id") == NO_ID else tracks.frame_index,
            score=found("score") if is_rated else None,
            confidence=found("confidence") if is_rated else None,
            status=Status(found("status")),
            status_final=Status(made("status_final")),
            best_score=found("best_score"),
            second_score=found("second_score"),
            num_close=made("num_close"),
            lock=Lock(made("lock")),
            source=MatchOrigin(made("source")),
            assigned_id=id_or_none(made("assigned_id")),
            guarded_id=id_or_none(made("guarded_id")),
            why=give_reasons(case, since),
            quality=_quality(case),
            num_candidates=case.trace("num_candidates"),
            candidates=tuple(_candidate(case, i) for i in case.candidate_ids()),
            context=Context(*(leaf.item() for leaf in jax.tree.leaves(record.context))),
            anchors=_anchors(case),
            sets=tuple(_object_set(case, place) for place in range(len(record.sets.score))),
            known_sets=tuple(
                _known_set(case, turn)
                for turn in range(case.num_passes)
                if case.passes("undecided", turn)
                and case.passes("status", turn) != GroupStatus.NONE
            ),
            pending=_pending(case, *(since or (tracks.frame_index, 0))),
        )


def _name(case: Case) -> str:
    """As `Tracks.display_name`, but with the objects that are really in question."""
    options = [case.names.get(i) or str(i) for i, _ in case.options()]
    if case.outcome in (Outcome.MATCH, Outcome.NEW):
        return case.name(case.decision("object_id"))
    if options and case.outcome in (Outcome.AMBIGUOUS, Outcome.PROVISIONAL_PARENT):
        return f"{case.label} {' or '.join(options)}?"
    return f"{case.label} new?"


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
        terms={
            term: Term(float(score) if present else None, float(weight), source)
            for term, score, present, weight, source in columns
        },
        veto=Veto(take("veto")),
        gate=Gate(take("gate")),
        held_by=case.holder(object_id, "object_id"),
        **{name: take(name) for name in _AS_TRACED},
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
        proposed_id=id_or_none(take("proposed_id")),
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


def _pending(case: Case, first_frame: int, num_detections: int) -> PendingTrack | None:
    if case.decision("pending_id") == NO_ID:
        return None
    blocked = dict(zip(case.decision("option_id"), case.decision("option_blocked"), strict=True))
    return PendingTrack(
        kind=_pending_kind(case.outcome),
        track_id=case.decision("pending_id"),
        first_frame=first_frame,
        num_detections=num_detections,
        options=tuple(
            Option(i, case.name(i), score, bool(blocked[i])) for i, score in case.options()
        ),
    )


def _pending_kind(outcome: Outcome) -> str:
    """The kind of track that an undecided detection belongs to."""
    return "ambiguous" if outcome == Outcome.AMBIGUOUS else "provisional"


def _follow_pending(tracks: Sequence[Tracks]) -> dict[tuple[int, int], tuple[int, int]]:
    """First frame and count so far of the pending track of each undecided detection."""
    seen: dict[tuple[str, int], tuple[int, int]] = {}
    followed = {}
    for frame in tracks:
        for row, track in enumerate(frame.pending_id.tolist()):
            # Objects that wait to be announced are no undecided tracks.
            if track == NO_ID or frame.reason[row] == Reason.SEEN_TOO_FEW_TIMES:
                continue
            key = (_pending_kind(Outcome(int(frame.outcome[row]))), track)
            first, count = seen.get(key, (frame.frame_index, 0))
            seen[key] = followed[frame.frame_index, row] = (first, count + 1)
    return followed
