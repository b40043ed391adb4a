"""`run`: from a source of frames to identities, with decoding ahead of the tracker."""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

from remind_jax import files
from remind_jax.backbone.opening import open_backbone
from remind_jax.backbone.registry import Backbone
from remind_jax.compiled.method_code import digest_of
from remind_jax.config import Config, load_config
from remind_jax.detectors import Detector, DetectorOptions, as_detector
from remind_jax.errors import OptionError, OutputError, SourceError
from remind_jax.files import as_path
from remind_jax.live_page.server import LivePage, parse_where
from remind_jax.live_page.view import LiveView
from remind_jax.outputs.frame_record import FrameRecord
from remind_jax.outputs.mcap_record import McapRecord
from remind_jax.outputs.result import Result
from remind_jax.outputs.store import DETECTIONS_NAME
from remind_jax.outputs.writer import CHECKPOINT_NAME, MEMORY_NAME, check_folder
from remind_jax.session.announcement import choose_after
from remind_jax.session.checkpoint import Checkpoints
from remind_jax.session.delay import choose_delay
from remind_jax.session.folder_run import run_alone, run_into
from remind_jax.session.frame_loop import FrameLoop
from remind_jax.session.live import Tracker
from remind_jax.session.progress import Progress, follow_run
from remind_jax.settings.ranges import check_function, check_switch
from remind_jax.sources import LiveSource, Sampling, Source, open_source
from remind_jax.sources.opening import NO_MASKS, check_options
from remind_jax.sources.source import SampledSource


def run(
    source: Any,
    *,
    masks: Any = None,
    detector: Any = None,
    detector_options: DetectorOptions | Mapping[str, Any] | None = None,
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
    delay: int | None = None,
    announce_after: int | None = None,
    overwrite: bool = False,
    resume: bool = False,
    mcap: str | Path | None = None,
    record: str | Path | None = None,
    live: bool | str = False,
    on_live: Callable[[str], None] | None = None,
    progress: Callable[[Progress], None] | bool | None = None,
    **source_options: Any,
) -> Result:
    """Tracks everything in a source and says who is who in every frame.

    Args:
      source: A camera (0, "/dev/video0"), the address of a stream, a video, a folder of images, a
        DAVIS or ScanNet++ folder, arrays, or an iterable; see
        `remind_jax.sources.open_source`.
      masks: Detections kept apart from the frames; those of the source's layout if left out.
      detector: ONNX segmentation model, or a function from an RGB frame to instances; used
        instead of the source's masks.
      detector_options: Thresholds and class lists of the detector.
      backbone: What patch features come from, for instance `"dinov3-vits16"` or
        `"onnx:encoder.onnx"`.
      weights: Converted weight file of the backbone; looked for where the environment variable
        `REMIND_WEIGHTS` says and in the user's cache folder if left out, then fetched.
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
        decide late, such as "plus", can do so. Left out, those wait `RECORDED_DELAY` frames before
        a recorded source, for which nobody waits, and none before a live one.
      announce_after: Detections after which an object gets its id, back to its first sight; what is
        seen less often stays provisional. `input.announce_after` of the configuration if left out,
        and 0 there is 1 for masks and `announcement.DETECTOR_DEFAULT` for a detector.
      overwrite: Allow an output folder with files in it.
      resume: Go on with the run in `out` that was killed or stopped, as if it had not been; source
        and options must be those that it was begun with. A complete run is given back as it is, an
        empty folder gets a new run.
      mcap: Record for Foxglove (`.mcap`); needs `out`.
      record: Folder that gets the frames as they were seen, and their detections, so that a live
        run can be repeated.
      live: True shows the run on a page that only this machine sees; `"HOST:PORT"` on one at that
        address.
      on_live: Gets the address of the page once it is there; printed to standard error if left
        out.
      progress: Called after every frame. Left out, a line on a terminal or in a notebook shows how
        far the run is, and nothing elsewhere; False for nothing at all.
      **source_options: Further options of `open_source`.

    Returns:
      Identities of every frame, as known at the end. After Ctrl-C, those so far, with `complete`
      false; a live source has no other end, and is complete.

    Raises:
      RemindError: If something about the input, the configuration or the output is wrong; what was
        written until then is kept and finished.

    Example:
      >>> import numpy as np
      >>> import remind_jax as rj
      >>> frames = np.random.default_rng(0).integers(0, 255, (3, 96, 128, 3), np.uint8)
      >>> maps = np.zeros((3, 96, 128), np.uint8)
      >>> maps[:, 16:80, 32:96] = 1  # one object, in every frame
      >>> result = rj.run(frames, masks=maps, progress=False)
      >>> [tracks.object_id.tolist() for tracks in result.tracks]
      [[0], [0], [0]]
    """
    check_options(source_options, run, detector_options=DetectorOptions)
    switches = {"overlay": overlay, "trace": trace, "overwrite": overwrite, "resume": resume}
    for name, value in switches.items():
        check_switch(name, value)
    check_function("on_live", on_live)
    check_function("progress", None if isinstance(progress, bool) else progress)
    if live is not False:
        parse_where(live)
    folder, recorded = _check_outputs(out, record, mcap, overwrite, resume)
    found_by = as_detector(detector, detector_options)
    backbone = open_backbone(
        backbone, weights=weights, feature_cache=feature_cache, quiet=progress is False
    )
    settings = load_config(config)
    after = choose_after(announce_after, settings.input.announce_after, found_by is not None)
    tracking = Tracker(
        settings, backbone, tracker=tracker, trace=trace, announce_after=after, memory=memory
    )
    frames = open_source(
        source, masks=masks, sampling=sampling, metadata=metadata, **source_options
    )
    _check_source(frames, tracking, found_by, folder if resume else None)
    if found_by is not None:
        _refuse_masks(frames, masks)
        if source_options.get("class_names") is not None:
            raise OptionError(
                "'class_names' names the classes of detections in memory, and a detector finds "
                "others; give detector_options={'class_names': [...]}",
                "class_names",
            )
    if folder is not None:
        _keep_apart(folder, frames, mcap, masks, metadata, weights, config, detector, memory)
    # Pictures cannot be written anew, so frames wait until most objects that will be announced are:
    # detectors miss them now and then, hence twice the detections that it takes.
    waiting = 2 * after if after > 1 else 0
    checkpoints = None if folder is None else Checkpoints(folder)
    delay = choose_delay(delay, tracking.method, is_live=isinstance(frames, LiveSource))
    revise = tracking.method.host.delayed
    delayed = revise(delay) if revise is not None and delay else None
    options = {
        "delay": delay,
        "trace": trace,
        "tracker_code": digest_of(tracking.method),
        "fingerprint": tracking.backbone.fingerprint,
    }
    loop = FrameLoop(tracking, frames, found_by, delayed, waiting, checkpoints)
    with contextlib.ExitStack() as stack:
        if live is not False:
            loop.view = stack.enter_context(_open_page(frames, live, on_live))
        if recorded is not None:
            loop.record = stack.enter_context(recorded)
        loop.progress = stack.enter_context(follow_run(progress, frames.name, frames.num_frames))
        if checkpoints is None:
            return run_alone(loop, options)
        opened_s = frames.opened_at.timestamp() if isinstance(frames, LiveSource) else 0.0
        viewed = None if mcap is None else McapRecord(mcap, opened_s)
        stack.enter_context(files.locked(checkpoints.run_folder))
        return run_into(
            loop,
            checkpoints,
            options,
            overlay=overlay,
            overwrite=overwrite,
            resume=resume,
            mcap=viewed,
        )


def _check_outputs(
    out: Any, record: Any, mcap: Any, overwrite: bool, resume: bool
) -> tuple[Path | None, FrameRecord | None]:
    """The folder of the run and the record of its frames, if there are any; nothing is changed."""
    needs_folder = {"resume": ("goes on with the run in a folder", resume)}
    needs_folder["mcap"] = ("records a run that is written to a folder", mcap is not None)
    for name, (what, is_given) in needs_folder.items():
        if is_given and out is None:
            raise OptionError(f"'{name}' {what}; give out", name)
    if resume and overwrite:
        why = "'resume' and 'overwrite' exclude each other; give one"
        raise OptionError(why, "resume", "overwrite")
    if resume and record is not None:
        why = "'record' would lack the frames before 'resume'; leave it out"
        raise OptionError(why, "record", "resume")
    recorded = None if record is None else FrameRecord(record, overwrite)
    if out is None:
        return None, recorded
    folder = as_path(out, "the output folder", OutputError)
    check_folder(folder, overwrite, resume)
    if mcap is not None:
        file = as_path(mcap, "the record", OutputError)
        if file.exists() and not (overwrite or (resume and folder.exists())):
            raise OutputError(f"'{file}' exists; choose another name or allow overwriting")
        if file.parent.absolute() != folder.absolute() and not file.parent.is_dir():
            raise OutputError(f"'{file}' cannot be written: there is no folder '{file.parent}'")
    # The record of detections has the same name in both.
    if recorded is not None and recorded.target.absolute() == folder.absolute():
        why = "'record' and 'out' are the same folder; give the frames a folder of their own"
        raise OptionError(why, "record", "out")
    return folder, recorded


def _check_source(
    frames: Source, tracking: Tracker, detector: Detector | None, resumed: Path | None
) -> None:
    """Refuses live sources that nobody finds anything in, or that a run would go on with.

    That run is in the folder `resumed`.
    """
    if isinstance(frames, SampledSource):
        frames.most_detections = tracking.most_detections
    if not isinstance(frames, LiveSource):
        return
    if resumed is not None:
        raise OutputError(
            f"'{frames.name}' is live and cannot be gone back in; start a new run into another "
            "folder, and go on (memory=, --memory) from what is remembered in "
            f"'{resumed}/{MEMORY_NAME}', or after a crash in "
            f"'{resumed}/{CHECKPOINT_NAME}/{MEMORY_NAME}'"
        )
    if detector is None:
        raise SourceError(f"'{frames.name}' brings no masks; give a detector")


def _refuse_masks(frames: Source, masks: Any) -> None:
    """Refuses masks that were chosen beside a detector, which would not be looked at."""
    chosen = masks if masks is not None else (frames.describe().get("reopen") or {}).get("masks")
    if chosen is not None and not (isinstance(chosen, str) and chosen == NO_MASKS):
        why = "masks and a detector exclude each other; give one, or masks='none' (--masks none)"
        raise OptionError(why, "masks", "detector")


def _keep_apart(out: Path, frames: Source, mcap: Any, *others: Any) -> None:
    """Refuses to write onto what is read."""
    arguments = frames.describe().get("reopen") or {}
    inputs = [arguments.get(name) for name in ("spec", "masks", "metadata")]
    # Words that name something else, such as "default", are no paths.
    inputs += [one for one in others if isinstance(one, (str, Path)) and Path(one).exists()]
    inputs = [path for path in inputs if path != NO_MASKS]
    files.refuse_folder(out, inputs, (DETECTIONS_NAME, CHECKPOINT_NAME))
    if mcap is not None:
        files.refuse_file(as_path(mcap, "the record", OutputError), inputs)


@contextlib.contextmanager
def _open_page(
    source: Source, where: bool | str, on_live: Callable[[str], None] | None
) -> Iterator[LiveView]:
    """The page of a run, and the view that it shows."""
    view = LiveView(source.name, source if isinstance(source, LiveSource) else None)
    with LivePage(view, where) as page:
        if on_live is None:
            print(f"live page: {page.address}", file=sys.stderr)
        else:
            on_live(page.address)
        yield view
