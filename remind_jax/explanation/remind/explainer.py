"""From the trace of the paper's tracker to explanations."""

from __future__ import annotations

import dataclasses
from typing import Any, cast

import jax
import numpy as np

from remind_jax.decision import NO_ID, Decisions, Outcome
from remind_jax.explanation.archive import first_rows
from remind_jax.explanation.explainer import Explainer, Name
from remind_jax.explanation.explanation import id_or_none, read_row
from remind_jax.explanation.remind.explanation import (
    Anchor,
    Candidate,
    Context,
    KnownSet,
    ObjectSet,
    Option,
    PendingTrack,
    RemindExplanation,
    Term,
    Voter,
)
from remind_jax.explanation.remind.reasons import give_reasons
from remind_jax.numerics.pytree import pytree
from remind_jax.remind.disambiguation.joint_assignments import GroupStatus
from remind_jax.remind.stages import Stages
from remind_jax.remind.thresholds import Thresholds
from remind_jax.remind.trace import (
    CandidateTrace,
    ContextTrace,
    DetectionTrace,
    PassTrace,
    SetTrace,
    Trace,
)
from remind_jax.tracks import Tracks


@pytree
class FrameRecord:
    """Everything known about the decisions of one frame; NumPy arrays without padding rows."""

    decisions: Decisions
    stages: Stages
    detections: DetectionTrace
    sets: SetTrace
    context: ContextTrace

    @classmethod
    def of_step(cls, num: int, decisions: Decisions, trace: Trace) -> FrameRecord:
        """The record of a frame of `num` detections."""
        sets = jax.tree.map(lambda leaf: leaf[trace.sets.valid], trace.sets)
        # A set explains as many detections as it has members.
        sets = dataclasses.replace(
            sets, detections=sets.detections[:, :num], member_id=sets.member_id[:, :num]
        )
        decided, stages, known = first_rows((decisions, trace.stages, trace.detections), num)
        return cls(decided, stages, known, sets, trace.context)

    def __len__(self) -> int:
        return len(self.decisions.outcome)

    def holder(self, object_id: int, other_than: int) -> int | None:
        """Another detection that has, or was assigned, an object; None if there is none."""
        for ids in (self.decisions.object_id, self.stages.assigned_id):
            rows = [int(row) for row in np.flatnonzero(ids == object_id) if row != other_than]
            if rows:
                return rows[0]
        return None


_TERMS = ("object", "background", "parts", "ring_prototypes")  # the last only if it is on
_MAX_SETS = 5


class RemindExplainer(Explainer[FrameRecord]):
    """Explains decisions of one run."""

    RECORD = FrameRecord
    record = staticmethod(FrameRecord.of_step)

    def _explain(self, record: FrameRecord, tracks: Tracks, row: int) -> RemindExplanation:
        label, name = tracks.labels[row], self._namer(tracks, row)
        d, stages, known = record.decisions, record.stages, record.detections
        is_rated, object_id = tracks.is_rated(row), int(d.object_id[row])
        outcome = Outcome(int(d.outcome[row]))
        seen = known.candidates
        options = tuple(
            Option(int(i), name(int(i)), float(score), bool(blocked))
            for i, score, blocked in zip(
                d.option_id[row], d.option_score[row], d.option_blocked[row], strict=True
            )
            if i != NO_ID
        )
        groups = known.group
        explanation = read_row(
            RemindExplanation,
            row,
            d,
            stages,
            known,
            frame=tracks.frame_index,
            time_s=float(tracks.time_s),
            frame_name=tracks.name,
            detection=row,
            label=label,
            name=name(object_id) if outcome.is_firm else _title(label, outcome, options, tracks),
            object_id=id_or_none(object_id),
            decided_at=None if object_id == NO_ID else tracks.frame_index,
            score=float(d.score[row]) if is_rated else None,
            confidence=float(d.confidence[row]) if is_rated else None,
            assigned_id=id_or_none(stages.assigned_id[row]),
            guarded_id=id_or_none(stages.guarded_id[row]),
            swappable=tuple(np.flatnonzero((groups == groups[row]) & (groups >= 0)).tolist()),
            why=(),
            candidates=tuple(
                _candidate(seen, row, place, record, name)
                for place in np.flatnonzero(seen.id[row] != NO_ID).tolist()
            ),
            context=read_row(Context, (), record.context),
            anchors=tuple(
                Anchor(int(k), int(known.anchor_id[k]), name(int(known.anchor_id[k])))
                for k in np.flatnonzero(known.anchor_id != NO_ID)
            ),
            sets=_best_sets(record.sets, name),
            known_sets=tuple(
                _known_set(known.passes, row, turn, name)
                for turn in range(known.passes.status.shape[1])
                if known.passes.undecided[row, turn]
                and known.passes.status[row, turn] != GroupStatus.NONE
            ),
            pending=None if d.pending_id[row] == NO_ID else PendingTrack(
                "ambiguous" if outcome == Outcome.AMBIGUOUS else "provisional",
                int(d.pending_id[row]),
                options,
            ),
        )  # fmt: skip
        why = give_reasons(explanation, options, cast(Thresholds, self._config.thresholds))
        return dataclasses.replace(explanation, why=why)


def _title(label: str, outcome: Outcome, options: tuple[Option, ...], tracks: Tracks) -> str:
    """As `Tracks.display_name`, but with the objects that are really in question."""
    if options and outcome in (Outcome.AMBIGUOUS, Outcome.PROVISIONAL_PARENT):
        names = [tracks.names.get(one.object_id) or str(one.object_id) for one in options]
        return f"{label} {' or '.join(names)}?"
    return f"{label} new?"


def _candidate(
    c: CandidateTrace, row: int, place: int, record: FrameRecord, name: Name
) -> Candidate:
    def take(field: str) -> Any:
        return getattr(c, field)[row, place]

    object_id = int(take("id"))
    columns = zip(_TERMS, take("value"), take("present"), take("weight"), strict=False)
    return read_row(
        Candidate,
        (row, place),
        c,
        object_id=object_id,
        name=name(object_id),
        terms={
            term: Term(float(score) if present else None, float(weight))
            for term, score, present, weight in columns
        },
        held_by=record.holder(object_id, other_than=row),
    )


def _best_sets(sets: SetTrace, name: Name) -> tuple[ObjectSet, ...]:
    """The best sets, each of other objects."""
    best: dict[tuple[int, ...], ObjectSet] = {}
    for place, members in enumerate(sets.member_id):
        ids = tuple(int(i) for i in members if i != NO_ID)
        score, coverage = float(sets.score[place]), float(sets.coverage[place])
        best.setdefault(ids, ObjectSet(score, coverage, ids, tuple(map(name, ids))))
    return tuple(best.values())[:_MAX_SETS]


def _known_set(passes: PassTrace, row: int, turn: int, name: Name) -> KnownSet:
    def take(field: str) -> Any:
        return getattr(passes, field)[row, turn]

    options = [int(i) for i in take("option_id") if i != NO_ID]
    voters = tuple(
        Voter(
            name=name(int(anchor)),
            object_id=int(anchor),
            detection=int(take("anchor_detection")[place]),
            distance=float(take("distance")[place]),
            remembered={
                option: float(take("remembered")[k, place])
                for k, option in enumerate(options)
                if take("num_remembered")[k, place] > 0
            },
        )
        for place, anchor in enumerate(take("anchor_id"))
        if anchor != NO_ID
    )
    return read_row(
        KnownSet,
        (row, turn),
        passes,
        turn=turn,
        detections=tuple(np.flatnonzero(passes.root[:, turn] == take("root")).tolist()),
        options=dict(zip(options, take("option_score").tolist(), strict=False)),
        proposed_id=id_or_none(take("proposed_id")),
        second=None if take("second") < 0 else float(take("second")),
        voters=voters,
    )
