"""A run into a folder: written as it goes, and gone on with after a kill."""

from __future__ import annotations

import contextlib
import dataclasses
import datetime
import platform
from collections.abc import Mapping
from typing import Any

import cv2
import jax
import msgspec
import numpy as np

import remind_jax
from remind_jax.errors import OutputError, RemindError
from remind_jax.outputs import store
from remind_jax.outputs.mcap_record import McapRecord
from remind_jax.outputs.result import Result
from remind_jax.outputs.run_records import KnownObject, RunInfo
from remind_jax.outputs.writer import MEMORY_NAME, RunWriter
from remind_jax.session.checkpoint import Checkpoints, Header
from remind_jax.session.frame_loop import FrameLoop
from remind_jax.session.live import FEATURES_GIVEN, Tracker
from remind_jax.sources import LiveSource


def run_alone(loop: FrameLoop, options: Mapping[str, Any]) -> Result:
    """Tracks all frames; nothing is written."""
    with loop.prepare() as ahead:
        first = loop.look_at_first(ahead)
        info = describe_run(loop, first.size, first.features is not None, options)
        return loop.conclude(info, loop.consume(ahead, None))


def run_into(
    loop: FrameLoop,
    checkpoints: Checkpoints,
    options: Mapping[str, Any],
    *,
    overlay: bool,
    overwrite: bool,
    resume: bool,
    mcap: McapRecord | None,
) -> Result:
    """Tracks all frames, and completes the folder whatever happens; the caller has locked it.

    With a run that it goes on with, it must have its `RunInfo` in common, `options` included.

    Raises:
      RemindError: If something about the input or the output is wrong; what was written until then
        is kept and finished.
    """
    tracker, folder = loop.tracker, checkpoints.run_folder
    start = 0 if tracker.state is None else int(tracker.state.frame)
    header = _find_earlier(loop, checkpoints, start, options) if resume else None
    if isinstance(header, Result):
        checkpoints.remove()
        return header
    if header is not None:
        loop.resume(header)
    with loop.prepare() as ahead:
        if header is not None and loop.num_before:
            info = RunInfo.from_json(header.info)
            named, given = _known_objects(tracker), info.object_names
            renamed = tuple(one for one in named if one.name != given.get(one.object_id, ""))
            info = dataclasses.replace(info, renamed=renamed)
            writer = RunWriter(folder, info, overlay=overlay, resume=True, mcap=mcap)
        else:
            first = loop.look_at_first(ahead)
            info = describe_run(loop, first.size, first.features is not None, options)
            writer = RunWriter(
                folder, info, overlay=overlay, overwrite=overwrite or resume, mcap=mcap
            )
            if isinstance(loop.source, LiveSource):
                loop.keep_on_disk(folder)
            checkpoints.begin(Header.of(info, start))
        with writer:
            loop.repeat(ahead, writer)
            try:
                complete = loop.consume(ahead, writer)
            except BaseException:
                # What was done is finished; what went wrong first is what is reported.
                with contextlib.suppress(RemindError):
                    loop.release(writer)
                with contextlib.suppress(RemindError):
                    _finish(loop.conclude(info, complete=False), tracker, writer)
                raise
            result = _finish(loop.conclude(info, complete), tracker, writer)
    if result.complete:
        checkpoints.remove()
    return result


def _find_earlier(
    loop: FrameLoop, checkpoints: Checkpoints, start: int, options: Mapping[str, Any]
) -> Result | Header | None:
    """The run in the folder if it is complete, else the header of its checkpoint, if any."""
    folder = checkpoints.run_folder
    run, found = store.read_run_json(folder / store.RUN_NAME), None
    if run is not None and run.complete:
        found = Result.load(folder)
        before = Header.of(found.info, start)
    else:
        found = before = checkpoints.find()
    if before is not None:
        info = RunInfo.from_json(before.info)
        # Frames are compared one by one later on.
        brings_features = info.backbone == FEATURES_GIVEN
        now = describe_run(loop, info.frame_size, brings_features, options)
        before.check_same(Header.of(now, start), folder)
    elif (folder / store.DETECTIONS_NAME).exists():
        raise OutputError(
            f"the run in '{folder}' left no checkpoints, so it cannot be gone on with; start it "
            "anew with --overwrite"
        )
    return found


def describe_run(
    loop: FrameLoop,
    frame_size: tuple[int, int],
    brings_features: bool,
    options: Mapping[str, Any],
) -> RunInfo:
    """What a run is made with, as far as it is known before it starts."""
    tracker, source, detector = loop.tracker, loop.source, loop.detector
    if not brings_features:
        tracker.follow_profile()
    config = tracker.config
    announcing = dataclasses.replace(config.input, announce_after=tracker.announce_after)
    # Capacities are those of a memory, if there is one.
    config = dataclasses.replace(config, static=tracker.static, input=announcing)
    described = None
    if detector is not None:  # maybe in numbers of NumPy, or with a path
        described = msgspec.to_builtins(
            detector.describe(), enc_hook=lambda one: getattr(one, "tolist", one.__str__)()
        )
    return RunInfo(
        name=source.name,
        source=source.describe(),
        frame_size=frame_size,
        fps=source.fps or 0.0,
        class_names=(),
        config=config.to_dict(),
        backbone=FEATURES_GIVEN if brings_features else tracker.backbone.name,
        versions={
            **{module.__name__: module.__version__ for module in (remind_jax, jax, np)},
            "opencv": cv2.__version__,
            "python": platform.python_version(),
        },
        device=jax.devices()[0].device_kind,
        started_at=datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
        detector=described,
        known_objects=_known_objects(tracker),
        options=dict(options),
    )


def _known_objects(tracker: Tracker) -> tuple[KnownObject, ...]:
    """What the memory knows now."""
    return tuple(KnownObject(one.object_id, one.label, one.name) for one in tracker.objects())


def _finish(result: Result, tracker: Tracker, writer: RunWriter) -> Result:
    """Writes all that is written at the end."""
    try:
        if tracker.state is not None:
            tracker.save(writer.folder / MEMORY_NAME)
    finally:  # what is small has room where the memory has none
        writer.finish(result)
    return result
