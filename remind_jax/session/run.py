"""`run`: from a source of frames to identities, with decoding ahead of the tracker."""

from __future__ import annotations

import contextlib
import dataclasses
import datetime
import importlib.metadata
import inspect
import platform
import time
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

import jax
import numpy as np

from remind_jax.backbone.opening import open_backbone
from remind_jax.backbone.registry import Backbone
from remind_jax.config import Config, load_config
from remind_jax.decision import NO_ID
from remind_jax.detectors import DetectorOptions, as_detector
from remind_jax.detectors.detector import Detector
from remind_jax.errors import ConfigError, OptionError, RemindError, SourceError, nearest_names
from remind_jax.explanation.archive import TraceArchive
from remind_jax.explanation.explainer import new_archive
from remind_jax.frame import Detections, Frame
from remind_jax.outputs.presence import UNDECIDED
from remind_jax.outputs.result import Result
from remind_jax.outputs.run_info import Event, RunInfo
from remind_jax.outputs.writer import RunWriter, check_folder
from remind_jax.printing.words import plural
from remind_jax.session.announcement import as_announced, choose_after
from remind_jax.session.live import FEATURES_GIVEN, Tracker
from remind_jax.session.preparation import Prepared
from remind_jax.session.progress import Progress, follow_run
from remind_jax.sources import Sampling, Source, open_source, prefetch
from remind_jax.tracks import Tracks

MEMORY_NAME = "memory.safetensors"
_AHEAD = 4  # frames that are decoded and reduced before the tracker asks for them


def run(
    source: Any,
    *,
    masks: Any = None,
    detector: Any = None,
    detector_options: DetectorOptions | None = None,
    backbone: str | Backbone = "patch-statistics",
    weights: str | Path | None = None,
    feature_cache: str | Path | None = None,
    config: str | Path | Config | Mapping[str, Any] = "default",
    tracker: str | None = None,
    sampling: Sampling | Mapping[str, Any] | None = None,
    metadata: str | Path | None = None,
    memory: str | Path | None = None,
    out: str | Path | None = None,
    overlay: bool = True,
    trace: bool = False,
    delay: int = 0,
    announce_after: int | None = None,
    overwrite: bool = False,
    progress: Callable[[Progress], None] | bool | None = None,
    **source_options: Any,
) -> Result:
    """Tracks everything in a source and says who is who in every frame.

    Args:
      source: A video, a folder of images, a DAVIS or ScanNet++ folder or tar, a feature file,
        arrays, or an iterable; see `remind_jax.sources.open_source`.
      masks: Detections kept apart from the frames; those of the source's layout if left out.
      detector: ONNX segmentation model, or a function from an RGB frame to instances; used
        instead of the source's masks.
      detector_options: Thresholds and class lists of the detector.
      backbone: What patch features come from, for instance `"dinov3-vits16"` or
        `"onnx:encoder.onnx"`.
      weights: Converted weight file of the backbone; looked for where the environment variable
        `REMIND_WEIGHTS` says and in the user's cache folder if left out.
      feature_cache: Folder of features that are kept and reused; none if left out.
      config: Configuration by name, by file, or as values.
      tracker: Method by name (`remind_jax.method.list_methods`) with the thresholds of the shipped
        configuration of that name, else its published ones; that of the configuration if left out.
      sampling: Which frames are processed.
      metadata: JSON with the classes of instance ids.
      memory: Memory file of an earlier run to go on from.
      out: Folder for everything the run leaves behind; nothing is written if left out.
      overlay: False leaves out the overlay video.
      trace: Keep what every decision was made of, for `Result.explain`.
      delay: Frames that answers wait, to be revised by what turns out meanwhile; only trackers that
        decide late, such as "plus", can do so.
      announce_after: Detections after which an object gets its id, back to its first sight; what is
        seen less often stays provisional. `input.announce_after` of the configuration if left out,
        and 0 there is 1 for masks and `announcement.DETECTOR_DEFAULT` for a detector.
      overwrite: Allow an output folder with files in it.
      progress: Called after every frame. Left out, a line on a terminal or in a notebook shows how
        far the run is, and nothing elsewhere; False for nothing at all.
      **source_options: Further options of `open_source`.

    Returns:
      Identities of every frame, as known at the end. After Ctrl-C, those so far, with `complete`
      false.

    Raises:
      RemindError: If something about the input, the configuration or the output is wrong; what was
        written until then is kept and finished.
    """
    _check_options(source_options)
    if out is not None:
        check_folder(Path(out), overwrite)
    finder = as_detector(detector, detector_options)
    eyes = open_backbone(backbone, weights=weights, feature_cache=feature_cache)
    config = load_config(config)
    after = choose_after(announce_after, config.input.announce_after, finder is not None)
    live = Tracker(config, eyes, tracker=tracker, trace=trace, announce_after=after)
    if memory is not None:
        live.load(memory)
    frames = open_source(
        source, masks=masks, sampling=sampling, metadata=metadata, **source_options
    )
    # Pictures cannot be written anew, so frames wait until most objects that will be announced are:
    # detectors miss them now and then, hence twice the detections that it takes.
    waiting = max(0, 2 * after - delay) if after > 1 else 0
    delayed = _delay_answers(live, delay)
    preparing = prefetch(_decode(frames, finder), lambda timed: _prepare(live, timed), depth=_AHEAD)
    with (
        follow_run(progress, frames.name, frames.num_frames) as follow,
        contextlib.closing(preparing) as ahead,
    ):
        session = _Session(live, frames, finder, follow, delayed, waiting)
        first = next(ahead, None)
        if first is None:
            raise SourceError(f"'{frames.name}' has no frames")
        info = describe_run(frames, live, first)
        if out is None:
            return session.conclude(info, session.consume(first, ahead, None))
        with RunWriter(out, info, overlay=overlay, overwrite=overwrite) as writer:
            try:
                complete = session.consume(first, ahead, writer)
            except Exception:
                # What was done is finished; what went wrong first is what is reported.
                with contextlib.suppress(RemindError):
                    session.release(writer)
                    _finish(session.conclude(info, complete=False), live, writer)
                raise
            return _finish(session.conclude(info, complete), live, writer)


def _check_options(source_options: Mapping[str, Any]) -> None:
    """Refuses options that neither a run nor a source has."""
    known = inspect.signature(open_source).parameters
    for name in source_options:
        if name not in known:
            hint = nearest_names(name, {*known, *inspect.signature(run).parameters})
            raise ConfigError(f"run has no option '{name}'; {hint}")


def _delay_answers(tracker: Tracker, delay: int) -> Any:
    """What revises answers, None if they are given at once."""
    if delay < 0:
        raise OptionError(f"'delay' is {delay}; give 0 or more frames", "delay")
    if not delay:
        return None
    if tracker.method.delayed is None:
        raise ConfigError(
            f"tracker '{tracker.method.name}' never revises an answer; leave out delay, or use "
            "tracker 'plus'"
        )
    return tracker.method.delayed(delay)


def _finish(result: Result, tracker: Tracker, writer: RunWriter) -> Result:
    """Writes all that is written at the end."""
    if tracker.state is not None:
        tracker.save(writer.folder / MEMORY_NAME)
    writer.finish(result)
    return result


class _Session:
    """The loop over frames of one run, and what it collects."""

    def __init__(
        self,
        tracker: Tracker,
        source: Source,
        detector: Detector | None,
        progress: Callable[[Progress], None] | None,
        delayed: Any = None,
        num_waiting: int = 0,
    ) -> None:
        self._delayed = delayed  # revises answers that wait, None if they are given at once
        self._num_waiting = num_waiting  # frames that wait for announcements
        self._waiting: deque[tuple[Frame, Tracks]] = deque()  # as decided
        self._tracker, self._source, self._detector = tracker, source, detector
        self._progress = progress
        self._decided: list[Tracks] = []
        self._events: list[Event] = []
        self._grown_at: list[int] = []
        self._timings: dict[str, list[float]] = {}
        self._first_frame_ms: float | None = None
        self._archive: TraceArchive | None = None  # made with the first trace
        self._identities: set[int] = set()
        self._num_detections = self._num_undecided = 0

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
            compile_s=getattr(self._tracker, "compile_s", None),
            skipped=tuple(self._source.skipped),
            events=tuple(self._events),
            grown_at=tuple(self._grown_at),
            complete=complete,
            trace=archive,
        )

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
        self._note(tracks.frame_index)
        self._report(tracks)

    def _note(self, frame_index: int) -> None:
        """Keeps what the tracker says of a frame."""
        if self._tracker.has_grown:
            self._grown_at.append(frame_index)
        for notice in self._tracker.notices:
            self._events.append(Event(frame_index, notice.kind, notice.message))

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
        if self._progress is not None:
            recent = [self._timings[stage][-20:] for stage in ("backbone", "step", "write")]
            self._progress(
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
        for reason, count in dataclasses.asdict(self._detector.dropped).items():
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


def _prepare(tracker: Tracker, timed: tuple[Frame, dict[str, float]]) -> Prepared:
    frame, spent = timed
    prepared = tracker.prepare(frame)
    return dataclasses.replace(prepared, stage_ms={**spent, **prepared.stage_ms})


def describe_run(source: Source, tracker: Tracker, first: Prepared) -> RunInfo:
    """What a run is made with, as far as it is known before it starts."""
    brings_features = first.features is not None
    backbone = FEATURES_GIVEN if brings_features else tracker.backbone.name
    # The thresholds that will decide, those made for the backbone among them.
    config = tracker.config if brings_features else tracker.config.for_backbone(backbone)
    config = dataclasses.replace(config, static=tracker.static)  # of a memory, if there is one
    announcing = dataclasses.replace(config.input, announce_after=tracker.announce_after)
    config = dataclasses.replace(config, input=announcing)
    return RunInfo(
        name=source.name,
        source=source.describe(),
        frame_size=first.frame.size,
        fps=source.fps or 0.0,
        class_names=(),
        config=config.to_dict(),
        backbone=backbone,
        versions={
            **{name: importlib.metadata.version(name) for name in ("remind_jax", "jax", "numpy")},
            "opencv": importlib.metadata.version("opencv-python-headless"),
            "python": platform.python_version(),
        },
        device=jax.devices()[0].device_kind,
        started_at=datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
    )
