"""Why REMIND plus took a detection for what it did: evidence, candidates and reasons.

Keys of the JSON are the field names here; absent values are null. Evidence is in log odds,
probabilities and confidences lie in [0, 1].
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any, cast

import numpy as np

from remind_jax.config import Config
from remind_jax.decision import NO_ID, Outcome, Reason
from remind_jax.explanation.plus.archive import PlusArchive, PlusRecord
from remind_jax.explanation.remind.account import to_jsonable
from remind_jax.explanation.remind.explain import find_detection, fit_record, tell_silence
from remind_jax.plus.state import PARTS, Stage
from remind_jax.plus.thresholds import PlusThresholds
from remind_jax.tracks import Tracks

FORMAT, VERSION = "remind-jax explanation of plus", 1


@dataclasses.dataclass(frozen=True)
class PlusCandidate:
    """A known object that the tracklet could have been."""

    object_id: int
    name: str
    log_odds: float  # sum of the parts
    probability: float  # beside all other candidates and a new object
    parts: dict[str, float]  # by `state.PARTS`
    held_by: int | None  # other detection of the frame that was taken for it


@dataclasses.dataclass(frozen=True)
class PlusExplanation:
    """Why one detection became what it became."""

    frame: int
    time_s: float
    frame_name: str
    detection: int
    label: str
    name: str  # `mug 4`, `mug 3 or 7?`
    outcome: Outcome
    reason: Reason
    object_id: int | None  # as told, after a delay if there was one
    told_at_once: int | None  # without it
    confidence: float | None  # None where it is left out
    stage: Stage  # how far the tracklet was decided before
    tracklet_id: int | None  # names the tracklet, and its object if that is new
    age: int  # detections of the tracklet, with this one
    is_decided: bool
    answer_id: int | None  # best answer, firm or not
    probability: float  # of the answer, before calibration
    margin: float | None  # log odds to the next best answer; None where nothing was open
    merged_id: int | None  # object that turned out to be the answer
    new_log_odds: float | None  # of being no known object; None where nothing was open
    new_probability: float | None
    candidates: tuple[PlusCandidate, ...]  # the most probable first
    why: tuple[str, ...]

    def to_json(self) -> dict[str, Any]:
        """The same as `json` can write it; codes are words."""
        return {"format": FORMAT, "version": VERSION} | to_jsonable(self)

    def to_text(self, width: int | None = None) -> str:
        """The same as a page of plain text, with lines of at most `width` characters if given."""
        from remind_jax.explanation.plus.text import render_text

        return render_text(self, width)

    def __str__(self) -> str:
        return self.to_text()


class PlusExplainer:
    """Explains decisions of one run."""

    def __init__(
        self, archive: PlusArchive, tracks: Sequence[Tracks], config: Mapping[str, Any]
    ) -> None:
        """Takes what a run left behind.

        Args:
          archive: Its trace.
          tracks: Its frames.
          config: Its configuration, nested.

        Raises:
          ConfigError: If this version does not know the configuration.
        """
        self._archive = archive
        self._tracks = tracks
        self._config = Config().updated(config)
        self._thresholds = cast(PlusThresholds, self._config.thresholds)

    def explain(self, frame: int, detection: int) -> PlusExplanation:
        """Why a detection became what it became.

        Args:
          frame: Number of the processed frame (`Tracks.frame_index`).
          detection: Row of the detection in its frame, from 0.

        Raises:
          OutputError: If the run has no such frame or detection, or its trace is damaged.
        """
        from remind_jax.explanation.plus.reasons import tell_reasons

        tracks = find_detection(self._tracks, frame, detection)
        record = fit_record(self._archive.frame(frame), tracks)
        bare = _gather(record, tracks, detection)
        why = tell_reasons(bare, self._thresholds)
        if bare.reason == Reason.SEEN_TOO_FEW_TIMES:
            why = (*why, tell_silence(self._config))
        return dataclasses.replace(bare, why=why)


def _gather(record: PlusRecord, tracks: Tracks, row: int) -> PlusExplanation:
    """Everything but the reasons."""
    v, label = record.verdicts, tracks.labels[row]
    stage = Stage(int(v.stage[row]))
    is_open = stage in (Stage.OPEN, Stage.FRESH)
    candidates = _candidates(record, row, label)
    return PlusExplanation(
        frame=tracks.frame_index,
        time_s=float(tracks.time_s),
        frame_name=tracks.name,
        detection=row,
        label=label,
        name=tracks.display_name(row),
        outcome=Outcome(int(tracks.outcome[row])),
        reason=Reason(int(tracks.reason[row])),
        object_id=_id(tracks.object_id[row]),
        told_at_once=_id(record.object_id[row]),
        confidence=tracks.shown_confidence(row),
        stage=stage,
        tracklet_id=_id(v.tracklet_id[row]),
        age=int(v.age[row]),
        is_decided=bool(v.is_decided[row]),
        answer_id=_id(v.answer_id[row]),
        probability=float(v.probability[row]),
        margin=float(v.margin[row]) if is_open and candidates else None,
        merged_id=_id(v.merged_id[row]),
        new_log_odds=float(v.new_odds[row]) if is_open else None,
        new_probability=(
            max(0.0, 1.0 - sum(one.probability for one in candidates)) if is_open else None
        ),
        candidates=candidates,
        why=(),
    )


def _candidates(record: PlusRecord, row: int, label: str) -> tuple[PlusCandidate, ...]:
    v = record.verdicts
    found = []
    for place in np.argsort(-v.option_belief[row], kind="stable"):
        object_id = int(v.option_id[row, place])
        if object_id == NO_ID:
            continue
        others = [int(k) for k in np.flatnonzero(v.answer_id == object_id) if k != row]
        found.append(
            PlusCandidate(
                object_id=object_id,
                name=f"{label} {object_id}",
                log_odds=float(v.option_odds[row, place]),
                probability=float(v.option_belief[row, place]),
                parts=dict(zip(PARTS, v.option_parts[row, place].tolist(), strict=True)),
                held_by=others[0] if others else None,
            )
        )
    return tuple(found)


def _id(value: Any) -> int | None:
    return None if int(value) == NO_ID else int(value)
