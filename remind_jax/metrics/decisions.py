"""What a tracker decided on each of its detections, in one table.

Letters: `N` detections, `C` candidates.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float, Int

from remind_jax.decision import NO_ID, Outcome
from remind_jax.tracks import Tracks

FIRM = (Outcome.MATCH, Outcome.NEW)
SOFT = (Outcome.AMBIGUOUS, Outcome.PROVISIONAL_PARENT)
NO_ROW = -1

# What stands in each column where there is no detection, in the order of the columns.
_NOTHING = (int(Outcome.EMPTY), NO_ID, NO_ID, NO_ID, 0.0)


@dataclasses.dataclass(frozen=True)
class Decisions:
    """Decisions of one frame or of many."""

    outcome: Int[np.ndarray, "N"]  # decision.Outcome
    object_id: Int[np.ndarray, "N"]  # firm id, else NO_ID
    pending_id: Int[np.ndarray, "N"]  # ambiguous or provisional track, NO_ID without one
    candidate_id: Int[np.ndarray, "N C"]  # what an undecided detection could be, NO_ID padding
    candidate_score: Float[np.ndarray, "N C"]

    @classmethod
    def of_tracks(cls, tracks: Sequence[Tracks]) -> Decisions:
        """All detections of a run."""
        if not tracks:
            none = np.zeros(0, np.int64)
            return cls(none, none, none, none.reshape(0, 0), np.zeros((0, 0)))
        width = max(frame.candidate_id.shape[1] for frame in tracks)

        def widen(values: np.ndarray, filler: float) -> np.ndarray:
            missing = width - values.shape[1]
            return np.pad(values, ((0, 0), (0, missing)), constant_values=filler)

        rows = [
            (
                frame.outcome,
                np.where(frame.is_firm, frame.object_id, NO_ID),
                frame.pending_id,
                widen(frame.candidate_id, NO_ID),
                widen(frame.candidate_score, 0.0),
            )
            for frame in tracks
        ]
        return cls(*(np.concatenate(column) for column in zip(*rows, strict=True)))

    @classmethod
    def of_ids(cls, ids: Int[np.ndarray, "N"]) -> Decisions:
        """Those of a tracker that is always sure."""
        num = len(ids)
        none = np.full((num, 0), NO_ID)
        matched = np.full(num, int(Outcome.MATCH))
        return cls(matched, ids, np.full(num, NO_ID), none, np.zeros((num, 0)))

    @property
    def is_firm(self) -> Bool[np.ndarray, "N"]:
        """Detections with one identity."""
        return np.isin(self.outcome, FIRM) & (self.object_id != NO_ID)

    def take(self, rows: Int[np.ndarray, "M"]) -> Decisions:
        """Decisions of the given rows; an empty one for NO_ROW."""
        columns = (getattr(self, field.name) for field in dataclasses.fields(self))
        return Decisions(
            *(
                take_or(column, rows, nothing)
                for column, nothing in zip(columns, _NOTHING, strict=True)
            )
        )


def take_or(values: np.ndarray, rows: Int[np.ndarray, "M"], otherwise: float) -> np.ndarray:
    """The values of the given rows; `otherwise` for NO_ROW."""
    taken = np.full((len(rows), *values.shape[1:]), otherwise, values.dtype)
    taken[rows != NO_ROW] = values[rows[rows != NO_ROW]]
    return taken
