"""What is kept of a frame of the paper's tracker, and one decision of it with what it rests on."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Mapping
from typing import Any

import jax
import numpy as np

from remind_jax.config import Config
from remind_jax.decision import NO_ID, Decisions, Outcome, Reason
from remind_jax.remind.stages import Stages
from remind_jax.remind.thresholds import Thresholds
from remind_jax.remind.trace import ContextTrace, DetectionTrace, SetTrace
from remind_jax.tracks import title_of


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class FrameRecord:
    """Everything known about the decisions of one frame; NumPy arrays without padding rows."""

    decisions: Decisions
    stages: Stages
    detections: DetectionTrace
    sets: SetTrace
    context: ContextTrace

    def __len__(self) -> int:
        return len(self.decisions.outcome)

    @functools.cached_property
    def candidate_places(self) -> list[dict[int, int]]:
        """Column of each candidate shown, per detection, in the order shown."""
        return [
            {object_id: place for place, object_id in enumerate(row) if object_id != NO_ID}
            for row in np.asarray(self.detections.candidates.id).tolist()
        ]

    @functools.cached_property
    def set_members(self) -> list[tuple[tuple[int, ...], tuple[int, ...]]]:
        """Objects of each set and the detections that they explain."""
        explained = [tuple(np.flatnonzero(row).tolist()) for row in self.sets.detections]
        members = np.asarray(self.sets.member_id).tolist()
        ids = [tuple(i for i in row if i != NO_ID) for row in members]
        return list(zip(ids, explained, strict=True))


@dataclasses.dataclass(frozen=True)
class Case:
    """A detection in its frame, with the configuration that it was judged by."""

    record: FrameRecord
    row: int  # detection
    label: str  # its class
    labels: Mapping[int, str]  # of known objects
    names: Mapping[int, str]  # given to objects by people
    config: Config

    @property
    def thresholds(self) -> Thresholds:
        """What it was judged by."""
        return self.config.thresholds

    @property
    def assignment(self) -> str:
        """How detections and objects were assigned, `joint` or `greedy`."""
        return self.config.static.switches.assignment

    @property
    def outcome(self) -> Outcome:
        """What became of it."""
        return Outcome(int(self.record.decisions.outcome[self.row]))

    @property
    def reason(self) -> Reason:
        """By which rule."""
        return Reason(int(self.record.decisions.reason[self.row]))

    def decision(self, field: str) -> Any:
        """A field of `Decisions` for this detection."""
        return _plain(getattr(self.record.decisions, field)[self.row])

    def stage(self, field: str) -> Any:
        """A field of `Stages` for this detection."""
        return _plain(getattr(self.record.stages, field)[self.row])

    def trace(self, field: str) -> Any:
        """A field of `DetectionTrace` for this detection."""
        return _plain(getattr(self.record.detections, field)[self.row])

    def passes(self, field: str, turn: int) -> Any:
        """A field of `PassTrace` for this detection in a pass."""
        return _plain(getattr(self.record.detections.passes, field)[self.row, turn])

    @property
    def num_passes(self) -> int:
        """Passes of the reconciliation."""
        return self.record.detections.passes.undecided.shape[1]

    def undecided_reason(self, turn: int) -> Reason | None:
        """Why it was undecided when a pass began, or after the last pass; None if it was not."""
        if turn >= self.num_passes:
            return self.reason if self.outcome == Outcome.AMBIGUOUS else None
        return Reason(self.passes("reason", turn)) if self.passes("undecided", turn) else None

    def candidate_ids(self) -> list[int]:
        """Candidates shown, by falling visual score."""
        return list(self._places[self.row])

    def candidate(self, object_id: int, field: str, row: int | None = None) -> Any:
        """A field of `CandidateTrace` for a candidate; None if it is not among those shown."""
        row = self.row if row is None else row
        place = self._places[row].get(object_id)
        if place is None:
            return None
        return _plain(getattr(self.record.detections.candidates, field)[row, place])

    @property
    def _places(self) -> list[dict[int, int]]:
        return self.record.candidate_places

    def name(self, object_id: int) -> str:
        """`mug 4`, or the name that people gave it."""
        return title_of(self.labels.get(object_id, self.label), object_id, self.names)

    def holder(self, object_id: int, field: str = "guarded_id") -> int | None:
        """Another detection that had an object at a stage, None if no other did.

        Stages: `assigned_id`, `guarded_id`, `object_id`.
        """
        given = self.record.decisions if field == "object_id" else self.record.stages
        (rows,) = np.nonzero(getattr(given, field) == object_id)
        rows = rows[rows != self.row]
        return int(rows[0]) if len(rows) else None

    def options(self, turn: int | None = None) -> list[tuple[int, float]]:
        """Objects that it could be and their scores: those of a pass, or the final ones."""
        if turn is None:
            ids, scores = self.decision("option_id"), self.decision("option_score")
        else:
            ids, scores = self.passes("option_id", turn), self.passes("option_score", turn)
        return [(int(i), float(s)) for i, s in zip(ids, scores, strict=True) if i != NO_ID]


def _plain(value: Any) -> Any:
    """Scalars as Python numbers."""
    return value.item() if np.ndim(value) == 0 and hasattr(value, "item") else value
