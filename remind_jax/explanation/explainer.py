"""From a recorded run to the explanation of one of its decisions, whatever method made it."""

from __future__ import annotations

import abc
import dataclasses
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, ClassVar, Generic

import numpy as np

from remind_jax.config import Config
from remind_jax.config.dotted_keys import flatten, nest
from remind_jax.decision import NO_ID, Decisions, Outcome, Reason
from remind_jax.errors import OutputError
from remind_jax.explanation.archive import TRACE_NAME, Record, TraceArchive
from remind_jax.explanation.explanation import Explanation, id_or_none
from remind_jax.method import Method, get_method
from remind_jax.printing.words import sentence
from remind_jax.tracks import Tracks, title_of

Name = Callable[[int], str]  # of an object by its id


class Explainer(abc.ABC, Generic[Record]):
    """Explains decisions of one run; a method names its own as `Host.explainer_name`."""

    RECORD: ClassVar[type]  # what is kept of a frame

    def __init__(
        self, archive: TraceArchive[Record], tracks: Sequence[Tracks], config: Mapping[str, Any]
    ) -> None:
        """Takes what a run left behind. Raises ConfigError if its tracker is unknown here."""
        self._archive = archive
        self._tracks = tracks
        # No sentence names a setting that is gone since the run.
        own = Config().updated({"tracker": config["tracker"]} if "tracker" in config else {})
        known = set(own.keys)
        self._config = own.updated(nest({k: v for k, v in flatten(config) if k in known}))

    @staticmethod
    @abc.abstractmethod
    def record(num: int, decisions: Decisions, trace: Any) -> Record:
        """What is kept of a frame."""

    @abc.abstractmethod
    def _explain(self, record: Record, tracks: Tracks, row: int) -> Explanation:
        """Why the detection became what the tracker decided, announced or not."""

    def _namer(self, tracks: Tracks, row: int) -> Name:
        """Titles of objects beside a detection; those of unknown class get the class of its own."""
        labels, label = self._archive.labels, tracks.labels[row]
        return lambda one: title_of(labels.get(one, label), one, tracks.names)

    def explain(self, frame: int, detection: int) -> Explanation:
        """Why a detection became what it became.

        Raises:
          OutputError: If the run has no such frame or detection, or its trace is damaged.
        """
        tracks = find_frame(self._tracks, frame)
        if detection not in range(len(tracks)):
            raise OutputError(
                f"frame {frame} has no detection {detection!r}; {_say_detections(len(tracks))}"
            )
        record = self._archive.frame(frame)
        if record is None or len(record) != len(tracks):
            raise OutputError(
                f"the trace does not fit frame {frame} of the run; run again with --trace"
            )
        explanation = self._explain(record, tracks, detection)
        object_id = id_or_none(tracks.object_id[detection])
        outcome, reason = Outcome(int(tracks.outcome[detection])), Reason(tracks.reason[detection])
        decided = (explanation.object_id, explanation.outcome, explanation.reason)
        is_unannounced = reason == Reason.SEEN_TOO_FEW_TIMES
        if decided == (object_id, outcome, reason) and not is_unannounced:
            return explanation
        why: tuple[str, ...]
        if is_unannounced:
            why = (
                "What it shows was detected too few times to be announced (input.announce_after "
                f"{self._config.input.announce_after}), so it is reported as provisional.",
            )
        elif explanation.object_id is not None:
            why = say_merged(explanation.name, tracks, detection)
        else:
            why = (
                "Of candidates, the answer counts merged objects as one, and leaves out what is "
                "not announced yet.",
            )
        return dataclasses.replace(
            explanation,
            name=tracks.display_name(detection),
            outcome=outcome,
            reason=reason,
            object_id=object_id,
            why=(*explanation.why, *why),
        )


def say_merged(decided: str, tracks: Tracks, row: int) -> tuple[str, ...]:
    """A sentence on an object, by the name it was decided as, that was merged into another."""
    if tracks.object_id[row] != NO_ID:
        return (sentence(f"{decided} was merged into {tracks.display_name(row)}"),)
    holds_it = np.isin(tracks.object_id, tracks.candidate_id[row, :1])
    return tuple(
        f"Its object and that of detection {other} were merged into {tracks.display_name(other)}, "
        f"and detection {other} is the better match."
        for other in np.flatnonzero(holds_it)[:1].tolist()
    )


def new_archive(method: Method) -> TraceArchive:
    """An empty archive for a run of a method that has an explainer."""
    return TraceArchive(method.name, method.explainer.RECORD)


def open_archive(run_dir: Path, tracker: str) -> TraceArchive | None:
    """The archive in the folder of a run of that tracker; None if it has none."""
    path = run_dir / TRACE_NAME
    if not path.exists():
        return None
    return TraceArchive(tracker, get_method(tracker).explainer.RECORD, path)


def find_frame(tracks: Sequence[Tracks], frame: int) -> Tracks:
    """The frame of that number. Raises OutputError if the run has no such frame."""
    for candidate in tracks:
        if candidate.frame_index == frame:
            return candidate
    known = [candidate.frame_index for candidate in tracks]
    raise OutputError(f"the run has no frame {frame!r}; {_say_frames(known)}")


def _say_frames(known: list[int]) -> str:
    if not known:
        return "it has none"
    gaps = "" if len(known) == known[-1] - known[0] + 1 else ", some of which were skipped"
    return f"it has frames {known[0]} to {known[-1]}{gaps}"


def _say_detections(num: int) -> str:
    if num == 0:
        return "nothing was detected in it"
    return "it has detection 0 only" if num == 1 else f"it has detections 0 to {num - 1}"
