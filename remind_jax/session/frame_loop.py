"""The loop over the frames of a run: decoding ahead of the tracker, and what is collected.

Of a live source nothing is decoded ahead: what waits gets old, so every frame is taken when the
tracker is ready for it, and is shown one frame of the tracker's own time later.
"""

from __future__ import annotations

import contextlib
import dataclasses
import time
from array import array
from collections import Counter, deque
from collections.abc import Callable, Generator, Iterator, Sequence
from pathlib import Path
from typing import Any

import jax
import numpy as np

from remind_jax.decision import NO_ID, Reason
from remind_jax.detectors.detector import Detector
from remind_jax.errors import SourceError, UnreadableFrame
from remind_jax.explanation.explainer import new_archive
from remind_jax.frame import Frame, SkippedFrame
from remind_jax.live_page.view import LiveView
from remind_jax.outputs.frame_record import FrameRecord
from remind_jax.outputs.presence import UNDECIDED
from remind_jax.outputs.result import Result
from remind_jax.outputs.run_records import Event, RunInfo
from remind_jax.outputs.writer import KeptTracks, RunWriter
from remind_jax.printing.words import plural
from remind_jax.session.checkpoint import Checkpoints, Header, Step
from remind_jax.session.live import Tracker
from remind_jax.session.preparation import Prepared
from remind_jax.session.progress import Progress
from remind_jax.sources import LiveSource, Source
from remind_jax.sources.prefetch import prefetch
from remind_jax.sources.source import Content, SampledSource
from remind_jax.tracks import Tracks

_AHEAD = 4  # frames that are decoded and reduced before the tracker asks for them


@dataclasses.dataclass(frozen=True)
class Upcoming:
    """A frame on its way to the tracker."""

    frame: Frame
    prepared: Prepared | None = None  # None for one that was done before
    dropped: Counter[str] = dataclasses.field(default_factory=Counter)  # by the detector


class FrameLoop:
    """The loop over frames of one run, and what it collects.

    Attributes:
      progress: Called after every frame, if set.
      view: Shows every frame at once, if set.
      record: Gets every frame with its detections, if set.
      num_before: Frames that were done before.
    """

    def __init__(
        self,
        tracker: Tracker,
        source: Source,
        detector: Detector | None,
        delayed: Any = None,
        num_waiting: int = 0,
        checkpoints: Checkpoints | None = None,
    ) -> None:
        """`delayed` revises answers that wait, `num_waiting` frames wait for announcements."""
        self._delayed, self._num_waiting = delayed, num_waiting
        self._waiting: deque[tuple[Frame, Tracks]] = deque()  # as decided
        self.tracker, self.source, self.detector = tracker, source, detector
        self._live = source if isinstance(source, LiveSource) else None
        if self._live is not None:
            self._live.get_ready_by(self._warm_up)
        self._checkpoints = checkpoints
        self._before: Sequence[tuple[Tracks, Step]] = ()  # frames that were done before, as decided
        self._first: Upcoming | None = None  # looked at, not done yet
        self.num_before = 0
        self.progress: Callable[[Progress], None] | None = None
        self.view: LiveView | None = None
        self.record: FrameRecord | None = None
        self._decided: list[Tracks] | KeptTracks = []
        self._last_index: int | None = None  # of the last frame that was written
        self._events: list[Event] = []
        self._grown_at: list[int] = []
        self._timings: dict[str, array[float]] = {}
        self._first_frame_ms: float | None = None
        self._compile_s = 0.0  # of what was done before
        self._dropped = Counter[str]()
        self._archive = new_archive(tracker.method) if tracker.traces else None
        self._identities: set[int] = set()
        self._num_detections = self._num_undecided = 0

    def resume(self, header: Header) -> None:
        """Takes the tracker to the last checkpoint of a run that was not completed."""
        assert self._checkpoints is not None
        self._before = self._checkpoints.resume(header, self.tracker, self._archive)
        self.num_before = len(self._before)

    def prepare(self) -> contextlib.closing[Generator[Upcoming, None, None]]:
        """The frames, decoded and reduced ahead of the tracker in another thread; see above."""
        upcoming = self._read()
        if self._live is None:
            upcoming = prefetch(upcoming, depth=_AHEAD, size_of=_count_bytes)
        return contextlib.closing(upcoming)

    def keep_on_disk(self, folder: Path) -> None:
        """Keeps the frames on the disk of a folder, so that memory does not grow with them."""
        self._decided = KeptTracks(folder)

    def look_at_first(self, ahead: Iterator[Upcoming]) -> Frame:
        """The first frame, before it is its turn. Raises SourceError if there is none."""
        self._first = next(ahead, None)
        if self._first is None:
            why = [f": '{one.name}' was left out, {one.reason}" for one in self.source.skipped]
            raise SourceError(f"'{self.source.name}' has no frames{(why or [''])[0]}")
        return self._first.frame

    def repeat(self, ahead: Iterator[Upcoming], writer: RunWriter) -> None:
        """Collects and writes again what was done before: everything but deciding.

        Raises:
          SourceError: If the frames are not those that the run was begun with.
        """
        for decided, step in self._before:
            upcoming = next(ahead, None)
            if upcoming is None:
                raise SourceError(
                    f"'{self.source.name}' ends before frame {decided.source_index} "
                    f"('{decided.name}'), which was done already; give the whole source, or "
                    "start the run anew with --overwrite"
                )
            self._hand_on(upcoming.frame, decided, step, writer)
            self._collect(step, self.tracker.identities.answer(decided))
            self._compile_s = step.compile_s
        self._before = ()
        writer.end_repeating()

    def consume(self, ahead: Generator[Upcoming, None, None], writer: RunWriter | None) -> bool:
        """Tracks every frame, until Ctrl-C; False if that cut a recording off."""
        complete = True
        if self.view is not None:
            self.view.remember(self.tracker.objects())
        try:
            if self._first is not None:
                self._take(self._first, writer)
                self._first = None
            for upcoming in ahead:
                self._take(upcoming, writer)
        except KeyboardInterrupt:
            complete = self._live is not None
            self.keep()
        finally:
            if self._live is not None:
                ahead.close()  # the source then says what it passed over
        self.release(writer)
        return complete

    def keep(self) -> None:
        """Makes a checkpoint of what was done so far."""
        if self._checkpoints is not None:
            self._checkpoints.save(self.tracker, self._archive)

    def release(self, writer: RunWriter | None) -> None:
        """Gives the answers that still wait."""
        if self._delayed is not None:
            self._waiting.extend(self._delayed.flush())
        self._keep(0, writer)

    def conclude(self, info: RunInfo, complete: bool) -> Result:
        """What was found so far, by what is announced now."""
        tracks = self.tracker.identities.conclude(self._decided)
        announced = self.tracker.identities.announcements
        archive = self._archive
        if archive is not None and not announced.is_identity:
            archive = archive.renumbered(announced.number)
        self._note_end(tracks)
        return Result(
            tracks=tracks,
            info=info,
            timings_ms={stage: times.tolist() for stage, times in self._timings.items()},
            first_frame_ms=self._first_frame_ms,
            compile_s=self._compile_s + self.tracker.compile_s,
            skipped=tuple(self.source.skipped),
            events=(*(Event(-1, "input", note) for note in self.source.notes), *self._events),
            grown_at=tuple(self._grown_at),
            memory=self.tracker.memory_use,
            complete=complete,
            trace=archive,
        )

    def _read(self) -> Generator[Upcoming, None, None]:
        """Every frame of the source, each when it is asked for."""
        waited = "decode" if self._live is None else "wait"
        number, start = 0, time.perf_counter()
        for frame in self.source:
            spent = {waited: 1000 * (time.perf_counter() - start)}
            frame = dataclasses.replace(frame, index=number)  # some may have been left out here
            before = self._before[number][0] if number < self.num_before else None
            upcoming = Upcoming(frame)
            try:
                # One that is not among those done before may be left out now as it was then.
                if before is None or before.source_index != frame.source_index:
                    upcoming = self._prepare(frame, spent)
                if before is not None:
                    _check_same(before, frame)
                    self.tracker.preparer.pass_over(frame, self.tracker.config)
            except UnreadableFrame as error:
                left_out = SkippedFrame(frame.name, str(error))
                if isinstance(self.source, SampledSource):
                    self.source.leave_out(left_out)
                else:
                    self.source.skipped.append(left_out)
            else:
                number += 1
                yield upcoming
            start = time.perf_counter()

    def _warm_up(self, content: Content) -> None:
        """Compiles and loads all for pictures of one size, so that the first does not age."""
        if content.image is None:
            return
        found = () if self.detector is None else self.detector(content.image)
        num_found = min(len(found), self.tracker.most_detections)
        height, width = content.image.shape[:2]
        self._compile_s += self.tracker.warm_up((height, width), num_detections=num_found)

    def _prepare(self, frame: Frame, spent: dict[str, float]) -> Upcoming:
        """Detects and reduces; takes the milliseconds that decoding took."""
        detector, dropped = self.detector, Counter[str]()
        if detector is not None:
            if frame.image is None:
                raise SourceError(f"frame '{frame.name}' has no image for the detector to look at")
            start, before = time.perf_counter(), Counter(detector.dropped)
            frame = dataclasses.replace(frame, detections=detector(frame.image))
            spent["detect"] = 1000 * (time.perf_counter() - start)
            dropped = Counter(detector.dropped) - before
        if self.record is not None:
            self.record.add(frame)
        prepared = self.tracker.prepare(frame)
        prepared = dataclasses.replace(prepared, stage_ms={**spent, **prepared.stage_ms})
        return Upcoming(frame, prepared, dropped)

    def _take(self, upcoming: Upcoming, writer: RunWriter | None) -> None:
        """Decides about a frame."""
        tracker, prepared = self.tracker, upcoming.prepared
        assert prepared is not None
        start = time.perf_counter()
        tracks = tracker.advance(prepared)
        if self.view is not None:
            self.view.show(upcoming.frame, tracks, tracker.events, tracker.memory_use)
        tracked = time.perf_counter()
        first_ms: float | None = None
        # From the arrival of a live frame until it is shown.
        age_ms = {} if self._live is None else {"age": 1000 * self._live.age_s(upcoming.frame)}
        if self._first_frame_ms is None:
            took_ms = sum(prepared.stage_ms.values()) + 1000 * (tracked - start)
            first_ms = age_ms.get("age", took_ms)
        decided = tracker.identities.decided
        assert decided is not None
        step = Step(
            timings_ms={**tracker.stage_ms, **age_ms},
            compile_s=self._compile_s + tracker.compile_s,
            first_frame_ms=first_ms,
            merges=tracker.identities.merges,
            evidence=None if self._delayed is None else self._evidence(),
            events=[*tracker.events, *self._news(tracks.frame_index)],
            has_grown=tracker.has_grown,
            dropped=upcoming.dropped,
            attention_slots=tracker.features.attention_slots,
        )
        self._hand_on(upcoming.frame, decided, step, writer)
        step.timings_ms["write"] = 1000 * (time.perf_counter() - tracked)
        self._record(tracks)
        if self._checkpoints is not None:
            self._checkpoints.add(decided, step)
            if self._checkpoints.is_due:
                self.keep()
        self._collect(step, tracks)

    def _evidence(self) -> dict[str, list[int]]:
        """What the delayed answers are revised by, as `json` can write it."""
        evidence = self.tracker.method.host.evidence(self.tracker.state)
        return {name: np.asarray(leaf).tolist() for name, leaf in evidence.items()}

    def _news(self, frame_index: int) -> list[Event]:
        """What happened to a live source before a frame."""
        news = [] if self._live is None else self._live.take_news()
        return [Event(frame_index, "source", message) for message in news]

    def _hand_on(self, frame: Frame, decided: Tracks, step: Step, writer: RunWriter | None) -> None:
        """Hands on a frame that was decided to whatever waits for it."""
        # What waits are images; masks of many detections would be larger.
        frame = dataclasses.replace(frame, detections=None, features=None)
        if self._delayed is None:
            self._waiting.append((frame, decided))
        else:
            self._waiting.extend(self._delayed.push(frame, decided, step.evidence))
        self._keep(self._num_waiting, writer)

    def _keep(self, num_waiting: int, writer: RunWriter | None) -> None:
        """Writes and collects all frames but the last ones."""
        while len(self._waiting) > num_waiting:
            frame, decided = self._waiting.popleft()
            if writer is not None:
                writer.add(frame, self.tracker.identities.answer(decided))
            self._decided.append(decided)
            self._last_index = decided.frame_index

    def _record(self, tracks: Tracks) -> None:
        """Keeps what the decisions of the frame were made of, if the tracker gives that."""
        tracker = self.tracker
        if self._archive is None:
            return
        decisions, objects = jax.device_get((tracker.state.decisions, tracker.state.objects))
        record = tracker.method.explainer.record(len(tracks), decisions, tracker.trace)
        class_names = tuple(tracker.preparer.class_ids)
        labels = {
            int(i): class_names[number]
            for i, number in zip(objects.id, objects.class_id, strict=True)
            if i != NO_ID
        }
        self._archive.add(tracks.frame_index, record, labels)

    def _collect(self, step: Step, tracks: Tracks) -> None:
        """Adds a frame to what the result will tell, and reports how far the run is."""
        for stage, milliseconds in step.timings_ms.items():
            self._timings.setdefault(stage, array("d")).append(milliseconds)
        if self._first_frame_ms is None:
            self._first_frame_ms = step.first_frame_ms
        self._events += step.events
        self._dropped += Counter(step.dropped)
        if step.has_grown:
            self._grown_at.append(tracks.frame_index)
        self._identities.update(int(i) for i in tracks.object_id if i != NO_ID)
        self._num_detections += len(tracks)
        self._num_undecided += int(np.isin(tracks.outcome, UNDECIDED).sum())
        if self.progress is not None:
            recent = [self._timings[stage][-20:] for stage in ("backbone", "step", "write")]
            self.progress(
                Progress(
                    num_done=len(self._timings["step"]),
                    num_frames=self.source.num_frames,
                    ms_per_frame=float(np.median(np.sum(recent, axis=0))),
                    num_identities=len(self._identities),
                    undecided_share=self._num_undecided / max(1, self._num_detections),
                )
            )

    def _note_end(self, tracks: Sequence[Tracks]) -> None:
        """Reports what is known at the end: of the source, the detector, objects without an id."""
        if self._last_index is None:
            return
        last = self._last_index
        self._events += self._news(last)
        for reason, count in self._dropped.items():
            message = f"{count} detections were dropped by the detector: {reason} mask"
            self._events.append(Event(last, "dropped", message))
        too_few = (one.pending_id[one.reason == Reason.SEEN_TOO_FEW_TIMES] for one in tracks)
        if num := len({one for ids in too_few for one in ids.tolist()}):
            least = self.tracker.identities.announce_after
            message = (
                f"{plural(num, 'object')} without an id: detected fewer than {least} times "
                "(--announce-after)"
            )
            self._events.append(Event(last, "announced", message))


def _check_same(was: Tracks, frame: Frame) -> None:
    """Makes sure that a frame is the one that was decided then."""
    if (was.source_index, was.name, was.frame_size) != (frame.source_index, frame.name, frame.size):
        raise SourceError(
            f"frame {frame.source_index} ('{frame.name}') is not what the run was begun with: in "
            f"its place was frame {was.source_index} ('{was.name}'); give the same source, or "
            "start the run anew with --overwrite"
        )


def _count_bytes(upcoming: Upcoming) -> int:
    """What a frame takes while it waits."""
    frame, prepared = upcoming.frame, upcoming.prepared
    masks = None if frame.detections is None else frame.detections.masks
    held = [frame.image, frame.features, masks]
    if prepared is not None:
        held += [prepared.image, *jax.tree.leaves(prepared.masks)]
    return sum(array.nbytes for array in held if array is not None)
