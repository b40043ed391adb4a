"""From the verdicts of REMIND plus to explanations."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Mapping
from typing import cast

import jax
import numpy as np
from jaxtyping import Array, Int

from remind_jax.decision import NO_ID, Decisions, Outcome, Reason
from remind_jax.explanation.archive import first_rows
from remind_jax.explanation.explainer import Explainer
from remind_jax.explanation.explanation import id_or_none
from remind_jax.explanation.plus.explanation import PlusCandidate, PlusExplanation
from remind_jax.explanation.plus.reasons import give_reasons
from remind_jax.plus.evidence import Evidence
from remind_jax.plus.thresholds import PlusThresholds
from remind_jax.plus.verdicts import Stage, Verdicts
from remind_jax.tracks import Tracks, title_of


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class PlusRecord:
    """What the decisions of one frame were made of; NumPy arrays without padding rows."""

    verdicts: Verdicts
    object_id: Int[Array, "N"]  # without delay; -1 without a firm identity

    def __len__(self) -> int:
        return len(self.object_id)


class PlusExplainer(Explainer[PlusRecord]):
    """Explains decisions of one run."""

    RECORD = PlusRecord

    @staticmethod
    def record(num: int, decisions: Decisions, trace: Verdicts) -> PlusRecord:
        """What is kept of a frame."""
        return first_rows(PlusRecord(trace, decisions.object_id), num)

    def _explain(self, record: PlusRecord, tracks: Tracks, row: int) -> PlusExplanation:
        v, label = record.verdicts, tracks.labels[row]
        stage = Stage(int(v.stage[row]))
        is_open = stage == Stage.OPEN
        candidates = _candidates(v, row, label, tracks.names)
        known = sum(candidate.probability for candidate in candidates)
        explanation = PlusExplanation(
            frame=tracks.frame_index,
            time_s=float(tracks.time_s),
            frame_name=tracks.name,
            detection=row,
            label=label,
            name=tracks.display_name(row),
            outcome=Outcome(int(tracks.outcome[row])),
            reason=Reason(int(tracks.reason[row])),
            object_id=id_or_none(tracks.object_id[row]),
            decided_at=self._decided_at.get(int(v.tracklet_id[row])),
            confidence=tracks.shown_confidence(row),
            id_without_delay=id_or_none(record.object_id[row]),
            stage=stage,
            tracklet_id=id_or_none(v.tracklet_id[row]),
            age=int(v.age[row]),
            is_decided=bool(v.is_decided[row]),
            answer_id=id_or_none(v.answer_id[row]),
            probability=float(v.probability[row]),
            margin=float(v.margin[row]) if is_open and candidates else None,
            new_log_odds=float(v.new_odds[row]) if is_open else None,
            new_probability=max(0.0, 1.0 - known) if is_open else None,
            candidates=candidates,
            why=(),
        )
        why = give_reasons(explanation, cast(PlusThresholds, self._config.thresholds))
        return dataclasses.replace(explanation, why=why)

    @functools.cached_property
    def _decided_at(self) -> dict[int, int]:
        """By tracklet, the frame in which it was decided."""
        found: dict[int, int] = {}
        for frame, record in self._archive.frames():
            v = record.verdicts
            for row in np.flatnonzero(v.is_decided & (v.tracklet_id != NO_ID)):
                found.setdefault(int(v.tracklet_id[row]), frame)
        return found


def _candidates(
    v: Verdicts, row: int, label: str, names: Mapping[int, str]
) -> tuple[PlusCandidate, ...]:
    found = []
    for place in np.argsort(-v.option_belief[row], kind="stable"):
        object_id = int(v.option_id[row, place])
        if object_id == NO_ID:
            continue
        others = [int(k) for k in np.flatnonzero(v.answer_id == object_id) if k != row]
        found.append(
            PlusCandidate(
                object_id=object_id,
                name=title_of(label, object_id, names),
                log_odds=float(v.option_odds[row, place]),
                probability=float(v.option_belief[row, place]),
                parts={k: float(getattr(v.evidence, k)[row, place]) for k in Evidence.kinds()},
                held_by=others[0] if others else None,
            )
        )
    return tuple(found)
