"""The account of a run of REMIND plus on the host and in `trace.npz`; all rows are detections."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float, Int

from remind_jax.decision import Decisions
from remind_jax.explanation.frame_archive import Columns, FrameArchive
from remind_jax.plus.state import Verdicts
from remind_jax.tracks import Tracks

if TYPE_CHECKING:
    from remind_jax.explanation.plus.account import PlusExplainer


@dataclasses.dataclass(frozen=True)
class PlusRecord:
    """What the decisions of one frame were made of; NumPy arrays without padding rows."""

    verdicts: Verdicts
    outcome: Int[np.ndarray, "N"]  # decision.Outcome, as told at once
    reason: Int[np.ndarray, "N"]  # decision.Reason
    object_id: Int[np.ndarray, "N"]  # -1 without a firm identity
    confidence: Float[np.ndarray, "N"]

    def __len__(self) -> int:
        return len(self.outcome)


_TOLD = ("outcome", "reason", "object_id", "confidence")
_WEIGHED = tuple(field.name for field in dataclasses.fields(Verdicts))


class PlusArchive(FrameArchive[PlusRecord]):
    """The records of a run of REMIND plus."""

    TRACKER = "plus"

    def explainer(self, tracks: Sequence[Tracks], config: Mapping[str, Any]) -> PlusExplainer:
        """Explains decisions of the run with these frames and this configuration."""
        from remind_jax.explanation.plus.account import PlusExplainer

        return PlusExplainer(self, tracks, config)

    def add(
        self,
        frame_index: int,
        num: int,
        decisions: Decisions,
        trace: Verdicts,
        class_names: Sequence[str],
    ) -> None:
        """Keeps one frame.

        Args:
          frame_index: Number of the processed frame.
          num: Detections of the frame; further rows are padding.
          decisions: Host arrays.
          trace: Host arrays.
          class_names: By class id; candidates are of the class of their detection.
        """
        del class_names
        told: dict[str, Any] = {name: np.asarray(getattr(decisions, name))[:num] for name in _TOLD}
        weighed: dict[str, Any] = {
            name: np.asarray(getattr(trace, name))[:num] for name in _WEIGHED
        }
        self._frames[frame_index] = PlusRecord(Verdicts(**weighed), **told)

    def _to_columns(self, frames: list[PlusRecord]) -> Columns:
        if not frames:
            return {}
        told = {name: [getattr(frame, name) for frame in frames] for name in _TOLD}
        weighed = {name: [getattr(frame.verdicts, name) for frame in frames] for name in _WEIGHED}
        return {f"told.{name}": np.concatenate(parts) for name, parts in told.items()} | {
            f"weighed.{name}": np.concatenate(parts) for name, parts in weighed.items()
        }

    def _from_columns(self, columns: Mapping[str, np.ndarray]) -> dict[int, PlusRecord]:
        ends = np.cumsum(columns["frame.detections"])
        starts = ends - columns["frame.detections"]
        frames = {}
        for index, *span in zip(columns["frame.index"].tolist(), starts, ends, strict=True):
            rows = slice(*span)
            told: dict[str, Any] = {name: columns[f"told.{name}"][rows] for name in _TOLD}
            weighed: dict[str, Any] = {name: columns[f"weighed.{name}"][rows] for name in _WEIGHED}
            frames[index] = PlusRecord(Verdicts(**weighed), **told)
        return frames
