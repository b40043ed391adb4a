"""From a recorded run to the explanation of one of its decisions."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence, Sized
from typing import Any, TypeVar

from remind_jax.config import Config
from remind_jax.decision import NO_ID, Outcome, Reason
from remind_jax.errors import OutputError
from remind_jax.explanation.remind.account import (
    Circumstances,
    Explanation,
    account_for,
    pending_kind,
)
from remind_jax.explanation.remind.archive import TraceArchive
from remind_jax.explanation.remind.case import Case
from remind_jax.explanation.remind.reasons import tell_reasons
from remind_jax.tracks import Tracks

Record = TypeVar("Record", bound=Sized)


class Explainer:
    """Explains decisions of one run."""

    def __init__(
        self, archive: TraceArchive, tracks: Sequence[Tracks], config: Mapping[str, Any]
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
        self._pending = _follow_pending(tracks)

    def explain(self, frame: int, detection: int) -> Explanation:
        """Why a detection became what it became.

        Args:
          frame: Number of the processed frame (`Tracks.frame_index`).
          detection: Row of the detection in its frame, from 0.

        Raises:
          OutputError: If the run has no such frame or detection, or its trace is damaged.
        """
        tracks = find_detection(self._tracks, frame, detection)
        record = fit_record(self._archive.frame(frame), tracks)
        case = Case(record, detection, tracks.labels[detection], self._archive.labels, self._config)
        since = self._pending.get((frame, detection))
        around = Circumstances(
            time_s=float(tracks.time_s),
            frame_name=tracks.name,
            name=_name(case),
            first_frame=None if since is None else since[0],
            num_detections=0 if since is None else since[1],
            is_rated=tracks.is_rated(detection),
        )
        told = account_for(case, around, tell_reasons(case, since))
        if tracks.reason[detection] != Reason.SEEN_TOO_FEW_TIMES:
            return told
        return dataclasses.replace(
            told,
            name=tracks.display_name(detection),
            outcome=Outcome(int(tracks.outcome[detection])),
            reason=Reason.SEEN_TOO_FEW_TIMES,
            object_id=None,
            why=(*told.why, tell_silence(self._config)),
        )


def tell_silence(config: Config) -> str:
    """Why a detection with an identity is told of without one."""
    return (
        "what it shows was detected too few times to be announced (input.announce_after "
        f"{config.input.announce_after}), so it is told of as provisional"
    )


def _name(case: Case) -> str:
    """As `Tracks.display_name`, but with the objects that are really in question."""
    options = [str(i) for i, _ in case.options()]
    if case.outcome in (Outcome.MATCH, Outcome.NEW):
        return case.name(case.decision("object_id"))
    if options and case.outcome in (Outcome.AMBIGUOUS, Outcome.PROVISIONAL_PARENT):
        return f"{case.label} {' or '.join(options)}?"
    return f"{case.label} new?"


def find_detection(tracks: Sequence[Tracks], frame: int, detection: int) -> Tracks:
    """The frame with this number, if it has such a detection.

    Raises:
      OutputError: If the run has no such frame or detection.
    """
    found = find_frame(tracks, frame)
    check_detection(found, detection)
    return found


def fit_record(record: Record | None, tracks: Tracks) -> Record:
    """The record of a frame.

    Raises:
      OutputError: If the trace has none, or one of another number of detections.
    """
    if record is None or len(record) != len(tracks):
        raise OutputError(
            f"the trace does not fit frame {tracks.frame_index} of the run; run again with --trace"
        )
    return record


def find_frame(tracks: Sequence[Tracks], frame: int) -> Tracks:
    """The frame of that number.

    Raises:
      OutputError: If the run has no such frame.
    """
    for candidate in tracks:
        if candidate.frame_index == frame:
            return candidate
    known = [candidate.frame_index for candidate in tracks]
    raise OutputError(f"the run has no frame {frame}; {_say_frames(known)}")


def check_detection(tracks: Tracks, detection: int) -> None:
    """Makes sure that a frame has that detection.

    Raises:
      OutputError: If it has not.
    """
    if not 0 <= detection < len(tracks):
        raise OutputError(
            f"frame {tracks.frame_index} has no detection {detection}; "
            f"{_say_detections(len(tracks))}"
        )


def _follow_pending(tracks: Sequence[Tracks]) -> dict[tuple[int, int], tuple[int, int]]:
    """First frame and count so far of the pending track of each undecided detection."""
    seen: dict[tuple[str, int], tuple[int, int]] = {}
    followed = {}
    for frame in tracks:
        for row, track in enumerate(frame.pending_id.tolist()):
            # Objects that wait to be announced are no undecided tracks.
            if track == NO_ID or frame.reason[row] == Reason.SEEN_TOO_FEW_TIMES:
                continue
            key = (pending_kind(Outcome(int(frame.outcome[row]))), track)
            first, count = seen.get(key, (frame.frame_index, 0))
            seen[key] = followed[frame.frame_index, row] = (first, count + 1)
    return followed


def _say_frames(known: list[int]) -> str:
    if not known:
        return "it has none"
    gaps = "" if len(known) == known[-1] - known[0] + 1 else ", some of which were skipped"
    return f"it has frames {known[0]} to {known[-1]}{gaps}"


def _say_detections(num: int) -> str:
    if num == 0:
        return "nothing was detected in it"
    return "it has detection 0 only" if num == 1 else f"it has detections 0 to {num - 1}"
