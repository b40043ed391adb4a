"""The loop over the frames of a run: decoding ahead of the tracker, and what is collected."""

from __future__ import annotations

import contextlib
import dataclasses
import time
from collections import deque
from collections.abc import Callable, Iterator
from typing import Any

import jax
import numpy as np

from remind_jax.decision import NO_ID
from remind_jax.detectors.detector import Detector
from remind_jax.errors import SourceError
from remind_jax.explanation.archive import TraceArchive
from remind_jax.explanation.explainer import new_archive
from remind_jax.frame import Detections, Frame
from remind_jax.outputs.presence import UNDECIDED
from remind_jax.outputs.result import Result
from remind_jax.outputs.run_info import Event, RunInfo
from remind_jax.outputs.writer import RunWriter
from remind_jax.printing.words import plural
from remind_jax.session.announcement import as_announced
from remind_jax.session.live import Tracker
from remind_jax.session.preparation import Prepared
from remind_jax.session.progress import Progress
from remind_jax.sources import Source, prefetch
from remind_jax.tracks import Tracks

_AHEAD = 4  # frames that are decoded and reduced before the tracker asks for them


class FrameLoop:
    """The loop over frames of one run, and what it collects.

    Attributes:
      progress: Called after every frame, if set.
    """

    def __init__(
        self,
        tracker: Tracker,
        source: Source,
        detector: Detector | None,
        delayed: Any = None,
        num_waiting: int = 0,
    ) -> None:
        """Collects nothing yet.

        Args:
          tracker: Decides.
          source: What the frames come from.
          detector: Finds detections in frames that bring none.
          delayed: Revises answers that wait; None if they are given at once.
          num_waiting: Frames that wait for announcements.
        """
        self._delayed, self._num_waiting = delayed, num_waiting
        self._waiting: deque[tuple[Frame, Tracks]] = deque()  # as decided
        self._tracker, self._source, self._detector = tracker, source, detector
        self.progress: Callable[[Progress], None] | None = None
        self._decided: list[Tracks] = []
        self._events: list[Event] = []
        self._grown_at: list[int] = []
        self._timings: dict[str, list[float]] = {}
        self._first_frame_ms: float | None = None
        self._archive: TraceArchive | None = None  # made with the first trace
        self._identities: set[int] = set()
        self._num_detections = self._num_undecided = 0

    def prepare(self) -> contextlib.AbstractContextManager[Iterator[Prepared]]:
        """The frames, decoded and reduced ahead of the tracker in another thread."""
        timed = _decode(self._source, self._detector)
        return contextlib.closing(prefetch(timed, self._prepare, depth=_AHEAD))

    def consume(self, first: Prepared, ahead: Iterator[Prepared], writer: RunWriter | None) -> bool:
        """Tracks every frame; Ctrl-C ends the loop. Returns whether there was none."""
        complete = True
        try:
            self._take(first, writer)
            for prepared in ahead:
                self._take(prepared, writer)
        except KeyboardInterrupt:
            complete = False
        self.release(writer)
        return complete

    def release(self, writer: RunWriter | None) -> None:
        """Gives the answers that still wait."""
        if self._delayed is not None:
            self._waiting.extend(self._delayed.flush())
        self._keep(0, writer)

    def conclude(self, info: RunInfo, complete: bool) -> Result:
        """What was found so far, by what is announced now."""
        self._note_drops()
        self._note_unannounced()
        announced = self._tracker.announcements
        archive = self._archive
        if archive is not None and not announced.is_identity:
            archive = archive.renumbered(announced.number)
        return Result(
            tracks=tuple(as_announced(announced, decided) for decided in self._decided),
            info=info,
            timings_ms=self._timings,
            first_frame_ms=self._first_frame_ms,
            compile_s=self._tracker.compile_s,
            skipped=tuple(self._source.skipped),
            events=tuple(self._events),
            grown_at=tuple(self._grown_at),
            complete=complete,
            trace=archive,
        )

    def _prepare(self, timed: tuple[Frame, dict[str, float]]) -> Prepared:
        frame, spent = timed
        prepared = self._tracker.prepare(frame)
        return dataclasses.replace(prepared, stage_ms={**spent, **prepared.stage_ms})

    def _take(self, prepared: Prepared, writer: RunWriter | None) -> None:
        start = time.perf_counter()
        tracks = self._tracker.advance(prepared)
        tracked = time.perf_counter()
        if self._first_frame_ms is None:
            before = sum(prepared.stage_ms.values())
            self._first_frame_ms = before + 1000 * (tracked - start)
        decided = self._tracker.decided
        assert decided is not None
        # What waits are images; masks of many detections would be larger.
        frame = dataclasses.replace(prepared.frame, detections=None, features=None)
        if self._delayed is None:
            self._waiting.append((frame, decided))
        else:
            self._waiting.extend(self._delayed.push(frame, decided, self._tracker.state))
        self._keep(self._num_waiting, writer)
        spent = {**self._tracker.stage_ms, "write": 1000 * (time.perf_counter() - tracked)}
        for stage, milliseconds in spent.items():
            self._timings.setdefault(stage, []).append(milliseconds)
        self._record(tracks)
        self._events += self._tracker.events
        if self._tracker.has_grown:
            self._grown_at.append(tracks.frame_index)
        self._report(tracks)

    def _keep(self, num_waiting: int, writer: RunWriter | None) -> None:
        """Writes and collects all frames but the last ones."""
        while len(self._waiting) > num_waiting:
            frame, decided = self._waiting.popleft()
            if writer is not None:
                writer.add(frame, as_announced(self._tracker.announcements, decided))
            self._decided.append(decided)

    def _record(self, tracks: Tracks) -> None:
        """Keeps what the decisions of the frame were made of, if the tracker gives that."""
        tracker = self._tracker
        if tracker.trace is None:
            return
        self._archive = self._archive or new_archive(tracker.method)
        decisions, objects = jax.device_get((tracker.state.decisions, tracker.state.objects))
        record = tracker.method.explainer.record(len(tracks), decisions, tracker.trace)
        labels = {
            int(i): tracker.class_names[number]
            for i, number in zip(objects.id, objects.class_id, strict=True)
            if i != NO_ID
        }
        self._archive.add(tracks.frame_index, record, labels)

    def _report(self, tracks: Tracks) -> None:
        self._identities.update(int(i) for i in tracks.object_id if i != NO_ID)
        self._num_detections += len(tracks)
        self._num_undecided += int(np.isin(tracks.outcome, UNDECIDED).sum())
        if self.progress is not None:
            recent = [self._timings[stage][-20:] for stage in ("backbone", "step", "write")]
            self.progress(
                Progress(
                    num_done=len(self._timings["step"]),
                    num_frames=self._source.num_frames,
                    ms_per_frame=float(np.median(np.sum(recent, axis=0))),
                    num_identities=len(self._identities),
                    undecided_share=self._num_undecided / max(1, self._num_detections),
                )
            )

    def _note_drops(self) -> None:
        """Reports detections that the detector found and gave up again."""
        if self._detector is None or not self._decided:
            return
        last = self._decided[-1].frame_index
        for reason, count in self._detector.dropped.items():
            if count:
                message = f"{count} detections were dropped by the detector: {reason} mask"
                self._events.append(Event(last, "dropped", message))

    def _note_unannounced(self) -> None:
        """Reports objects that were not announced."""
        num, after = len(self._tracker.announcements.counts), self._tracker.announce_after
        if num and self._decided:
            message = (
                f"{plural(num, 'object')} without an id: detected fewer than {after} times "
                "(--announce-after)"
            )
            self._events.append(Event(self._decided[-1].frame_index, "announced", message))


def _decode(source: Source, detector: Detector | None) -> Iterator[tuple[Frame, dict[str, float]]]:
    """Frames with detections and the milliseconds that decoding and detecting took."""
    start = time.perf_counter()
    for frame in source:
        decoded = time.perf_counter()
        spent = {"decode": 1000 * (decoded - start)}
        if detector is not None:
            if frame.image is None:
                raise SourceError(f"frame '{frame.name}' has no image for the detector to look at")
            found: Detections = detector(frame.image)
            frame = dataclasses.replace(frame, detections=found)
            spent["detect"] = 1000 * (time.perf_counter() - decoded)
        yield frame, spent
        start = time.perf_counter()
