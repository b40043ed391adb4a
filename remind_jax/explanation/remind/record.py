"""What is kept of a frame of the paper's tracker."""

from __future__ import annotations

import dataclasses

import jax
import numpy as np

from remind_jax.decision import Decisions
from remind_jax.explanation.archive import first_rows
from remind_jax.remind.stages import Stages
from remind_jax.remind.trace import ContextTrace, DetectionTrace, SetTrace, Trace


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
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
