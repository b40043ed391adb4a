"""A run into a folder: written as it goes, and gone on with after a kill."""

from __future__ import annotations

import contextlib
import dataclasses
import datetime
import json
import platform
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import cv2
import jax
import numpy as np

import remind_jax
from remind_jax.detectors import Detector
from remind_jax.errors import OutputError, RemindError
from remind_jax.outputs import store
from remind_jax.outputs.result import Result
from remind_jax.outputs.run_info import KnownObject, RunInfo
from remind_jax.outputs.writer import MEMORY_NAME, RunWriter, ViewerRecord
from remind_jax.session.checkpoint import Checkpoints, check_same, make_header
from remind_jax.session.frame_loop import FrameLoop
from remind_jax.session.journal import checksum_of_file
from remind_jax.session.live import FEATURES_GIVEN, Tracker
from remind_jax.sources import LiveSource, Source


@dataclasses.dataclass(frozen=True)
class Origin:
    """What a run is made with, before its first frame."""

    source: Source
    detector: Detector | None
    tracker: Tracker
    beside: Mapping[str, Any]  # what `RunInfo` does not say, as `json` can write it

    @property
    def start(self) -> int:
        """Frames that the memory has seen before the run."""
        return 0 if self.tracker.state is None else int(self.tracker.state.frame)

    def describe(self, frame_size: tuple[int, int], brings_features: bool) -> RunInfo:
        """As `describe_run`."""
        return describe_run(self.source, self.detector, self.tracker, frame_size, brings_features)


def run_into(
    folder: Path,
    loop: FrameLoop,
    checkpoints: Checkpoints,
    origin: Origin,
    overlay: bool,
    overwrite: bool,
    resume: bool,
    viewers: Sequence[ViewerRecord] = (),
) -> Result:
    """Tracks all frames, and completes the folder whatever happens; the caller has locked it.

    Args:
      folder: Where to write to.
      loop: Over the frames.
      checkpoints: In that folder.
      origin: What the run is made with.
      overlay: False leaves out the overlay video.
      overwrite: Allow a folder with files in it.
      resume: Go on with the run that is there, if there is one.
      viewers: Records that get every frame as well.

    Raises:
      RemindError: If something about the input or the output is wrong; what was written until then
        is kept and finished.
    """
    journal = None
    if resume:
        finished = _find_finished(folder, origin)
        if finished is not None:
            checkpoints.remove()
            return finished
        journal = checkpoints.find()
    if journal is not None:
        _check_origin(journal.header, origin, folder)
        loop.go_on_after(journal)
    elif resume and (folder / store.DETECTIONS_NAME).exists():
        raise OutputError(
            f"the run in '{folder}' left no checkpoints, so it cannot be gone on with; start it "
            "anew with --overwrite"
        )
    with loop.prepare() as ahead:
        if journal is not None and loop.num_before:
            info = RunInfo.from_json(journal.header["info"])
            writer = RunWriter(folder, info, overlay=overlay, resume=True, viewers=viewers)
        else:
            first = loop.look_at_first(ahead)
            info = origin.describe(first.size, first.features is not None)
            is_live = isinstance(origin.source, LiveSource)
            writer = RunWriter(
                folder,
                info,
                overlay=overlay,
                overwrite=overwrite or resume,
                viewers=viewers,
                endless=is_live,
            )
            if is_live:
                loop.keep_on_disk(folder)
            checkpoints.begin(info, origin.start, origin.beside)
        with writer:
            try:
                loop.repeat(ahead, writer)
                complete = loop.consume(ahead, writer)
            except Exception:
                # What was done is finished; what went wrong first is what is reported.
                with contextlib.suppress(RemindError):
                    loop.release(writer)
                    _finish(loop.conclude(info, complete=False), origin.tracker, writer)
                raise
            result = _finish(loop.conclude(info, complete), origin.tracker, writer)
    if result.complete:
        checkpoints.remove()
    return result


def describe_run(
    source: Source,
    detector: Detector | None,
    tracker: Tracker,
    frame_size: tuple[int, int],
    brings_features: bool,
) -> RunInfo:
    """What a run is made with, as far as it is known before it starts.

    Args:
      source: Of the frames.
      detector: Finds the detections; None for given masks.
      tracker: Before the first frame.
      frame_size: Height and width of the first frame in pixels.
      brings_features: Whether frames come with features of their own.
    """
    backbone = FEATURES_GIVEN if brings_features else tracker.backbone.name
    # The thresholds that will decide, those made for the backbone among them.
    config = (
        tracker.config
        if brings_features
        else tracker.config.for_backbone(*tracker.backbone.identity)
    )
    config = dataclasses.replace(config, static=tracker.static)  # of a memory, if there is one
    announcing = dataclasses.replace(config.input, announce_after=tracker.announce_after)
    config = dataclasses.replace(config, input=announcing)
    return RunInfo(
        name=source.name,
        source=source.describe(),
        frame_size=frame_size,
        fps=source.fps or 0.0,
        class_names=(),
        config=config.to_dict(),
        backbone=backbone,
        versions={
            **{module.__name__: module.__version__ for module in (remind_jax, jax, np)},
            "opencv": cv2.__version__,
            "python": platform.python_version(),
        },
        device=jax.devices()[0].device_kind,
        started_at=datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
        detector=None if detector is None else detector.describe(),
        known_objects=tuple(
            KnownObject(one.object_id, one.label, one.name) for one in tracker.objects()
        ),
    )


def describe_files(
    memory: str | Path | None, tracker: Tracker, detector: Detector | None
) -> dict[str, Any]:
    """Checksums of the files that a run is made with, and of the weights of its backbone."""
    network = None if detector is None else detector.describe().get("file")
    return {
        "backbone": tracker.backbone.fingerprint,
        "memory": None if memory is None else checksum_of_file(memory),
        "detector": None if network is None else checksum_of_file(network),
    }


def _find_finished(folder: Path, origin: Origin) -> Result | None:
    """The run in the folder, if it is complete.

    Raises:
      OutputError: If it was made with something else.
    """
    run = store.read_run_json(folder / store.RUN_NAME)
    if run is None or not run.complete:
        return None
    result = Result.load(folder)
    before = {"info": result.info.to_json()}
    now = origin.describe(result.info.frame_size, result.info.backbone == FEATURES_GIVEN)
    check_same(_without_names(before), _without_names({"info": now.to_json()}), folder)
    return result


def _without_names(header: dict[str, Any]) -> dict[str, Any]:
    """Without what is known only at the end of a run."""
    left_out = {"class_names", "fps"}
    info = {name: value for name, value in header["info"].items() if name not in left_out}
    return json.loads(json.dumps({"info": info}))


def _check_origin(header: Mapping[str, Any], origin: Origin, folder: Path) -> None:
    """Makes sure that a run is gone on with by what it was begun with.

    Raises:
      OutputError: If something differs.
    """
    before = RunInfo.from_json(header["info"])
    # Frames are compared one by one later on.
    now = origin.describe(before.frame_size, before.backbone == FEATURES_GIVEN)
    names = ("info", "start", "beside")
    check_same(
        {name: header.get(name) for name in names},
        make_header(now, origin.start, origin.beside),
        folder,
    )


def _finish(result: Result, tracker: Tracker, writer: RunWriter) -> Result:
    """Writes all that is written at the end."""
    if tracker.state is not None:
        tracker.save(writer.folder / MEMORY_NAME)
    writer.finish(result)
    return result
