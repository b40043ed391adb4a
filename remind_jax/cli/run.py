"""`remind run`: from a video or folder to identities and an output folder."""

from __future__ import annotations

import contextlib
import dataclasses
import json
import os
import re
import sys
import webbrowser
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from tyro.conf import Positional, arg

from remind_jax.cli import process
from remind_jax.cli.flags import (
    Assignments,
    BackboneName,
    DetectionFlags,
    LiveFlags,
    SamplingFlags,
    TrackerName,
    flags,
    load_config_with,
)
from remind_jax.cli.progress import RunDisplay
from remind_jax.cli.streams import OutputStops
from remind_jax.cli.summary import print_summary, summary_facts
from remind_jax.errors import RemindError, SourceError
from remind_jax.printing.terminal import print_lines, printable

if TYPE_CHECKING:
    from remind_jax.config import Config
    from remind_jax.outputs.result import Result
    from remind_jax.sources import Source

DEFAULT_FOLDER = Path("runs")


@flags
class Layout:
    """What to read where a folder leaves a choice."""

    metadata: Path | None = None  # JSON with the class of each instance id
    sequence: str | None = None  # which one, where a DAVIS folder holds several
    unlabelled: Literal["error", "skip"] = "error"  # instances without class
    image_fps: float | None = None
    """Images per second where there are no times; left out, an image is a tenth of a second."""
    allow_size_change: bool = False  # go on when a recording's frame size changes, else skip frames


@flags
class Run:
    """Track every object of a video and say who is who in every frame.

    Instances come from a detector or from masks; what was found goes to a folder.

    Examples:
      remind run rooms.mp4 --detector yolo11n-seg.onnx --classes chair cup
      remind run frames/ --masks masks/            instance maps, one per image
      remind run DAVIS --sequence bear             masks of the layout
      remind run rooms.mp4 --masks detections.json COCO run-length masks
      remind run frames/ --masks masks/ --set thresholds.decision.new=1.5
      remind run tuesday/ --memory runs/monday/memory.safetensors
      remind run rooms.mp4 --masks masks/ --resume  go on after a crash or a kill
      remind run 0 --detector yolo11n-seg.onnx --live  a camera, seen in a browser
      remind run rtsp://10.0.0.5/main --detector m.onnx  a stream
    """

    # video, folder of images, DAVIS or ScanNet++ folder; number of a camera, or address of a stream
    # (rtsp, rtsps, http, https)
    source: Annotated[Positional[str], arg(metavar="SOURCE")]
    # folder of instance maps, or COCO JSON; 'none' ignores those of the layout
    masks: Path | None = None
    detector: Path | None = None  # ONNX segmentation export (YOLO-seg, RF-DETR-seg)
    backbone: BackboneName = "patch-statistics"
    weights: Path | None = None  # converted weights; found or fetched if left out
    feature_cache: Path | None = None  # keep features there and reuse them
    # configuration by name (see 'remind config list') or YAML file
    config: Annotated[str, arg(metavar="NAME|FILE")] = "default"
    tracker: TrackerName = None
    changes: Assignments = ()
    class_agnostic: bool = False  # compare all detections whatever their classes
    memory: Path | None = None  # go on from the memory of an earlier run
    out: Path | None = None  # output folder; runs/NAME if left out
    overwrite: bool = False  # allow an output folder with files in it
    resume: bool = False  # go on with the run in the folder that was killed or stopped
    no_overlay: bool = False  # leave out the overlay video
    trace: bool = False  # keep what every decision was made of, for 'remind explain'
    mcap: Path | None = None  # record for Foxglove (out.mcap)
    # frames that answers wait to be revised by what turns out meanwhile; for trackers that do so 20
    # before a recording and 0 before a live source if left out
    delay: int | None = None
    # detections after which an object gets its id; 1 for masks, 5 for a detector if left out
    announce_after: Annotated[int | None, arg(metavar="N")] = None
    quiet: bool = False  # say nothing but errors
    json: bool = False  # print the summary as JSON on stdout
    sampling: SamplingFlags = SamplingFlags()
    detection: DetectionFlags = DetectionFlags()
    layout: Layout = Layout()
    live_source: LiveFlags = LiveFlags()

    def execute(self) -> int:
        """Runs, shows progress, prints the summary; returns the exit code."""
        from remind_jax.sources import open_source

        self.detection.check_used_by(self.detector)
        source = open_source(
            self.source,
            sampling=self.sampling,
            **scene_options(self.layout, self.masks),
            **self.live_source.as_options(),
        )
        name = re.sub(r"[^\w.+-]+", "_", source.name).strip("._") or "run"
        out = self.out or DEFAULT_FOLDER / name
        agnostic = (("input.class_agnostic=true",),) if self.class_agnostic else ()
        config = load_config_with(self.config, (*self.changes, *agnostic), tracker=self.tracker)
        from remind_jax.backbone.opening import obtain_named

        obtain_named(self.backbone, self.weights, quiet=self.quiet)
        display = RunDisplay(source.name, source.num_frames, is_shown=not self.quiet)
        stop = getattr(source, "stop", None)  # a live source may wait for long
        if stop is not None:
            display.on_stop = stop
        try:
            result = self._track(display, out, source, config)
        except KeyboardInterrupt:
            if display.signal is None:
                raise
            process.complain("stopped")  # before the first frame
            return process.stopped_by(display.signal)
        if not (display.num_done or self.quiet or self.json):
            print_lines(f"the run in {out} is finished already; nothing was done")
        try:
            if self.json:
                print(json.dumps(summary_facts(result, out), indent=1))
            elif not self.quiet:
                print_summary(result, out)
        except OutputStops:
            if display.signal is None:  # else the terminal may be what was closed
                raise
        was_stopped = stop is not None and display.signal is not None
        is_fine = result.complete and not was_stopped
        return process.FINE if is_fine else process.stopped_by(display.signal)

    def _track(self, display: RunDisplay, out: Path, source: Source, config: Config) -> Result:
        page = self.live_source.live
        return track(
            display,
            out,
            source=source,
            detector=self.detector,
            detector_options=self.detection,
            backbone=self.backbone,
            weights=self.weights,
            feature_cache=self.feature_cache,
            config=config,
            memory=self.memory,
            overlay=not self.no_overlay,
            trace=self.trace,
            delay=self.delay,
            announce_after=self.announce_after,
            overwrite=self.overwrite,
            resume=self.resume,
            mcap=self.mcap,
            record=self.live_source.record,
            live=False if page is None else page.where,
            on_live=self._tell_page,
        )

    def _tell_page(self, address: str) -> None:
        """Says where the live page is, and opens it where there is a display."""
        if not self.quiet:
            print(printable(f"live page: {address}"), file=sys.stderr)
        wants_browser = not self.live_source.no_browser and not os.environ.get("REMIND_NO_BROWSER")
        if wants_browser and has_display():
            with contextlib.suppress(webbrowser.Error, OSError):
                webbrowser.open(address)


def track(display: RunDisplay, out: Path, **options: Any) -> Result:
    """`remind_jax.run` behind a progress bar.

    Raises:
      RemindError: As `remind_jax.run`, with a note where to find what was done until then.
    """
    from remind_jax.session.run import run

    try:
        with display:
            return run(options.pop("source"), out=out, progress=display, **options)
    except RemindError as error:
        if display.signal is not None and not display.num_done:
            raise KeyboardInterrupt from error  # stopped before a live source gave anything
        if display.num_done:
            error.add_note(f"what was done until then ({display.num_done} frames) is in {out}")
        raise


def has_display() -> bool:
    """Whether a browser would have a window, as far as the environment says."""
    if sys.platform in ("darwin", "win32"):
        return True
    return bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))


def scene_options(layout: Layout, masks: Path | None, num_scenes: int = 1) -> dict[str, Any]:
    """How scenes are opened, as options of `open_source`.

    Raises:
      SourceError: If masks are given for several scenes.
    """
    options = dataclasses.asdict(layout)
    if masks is not None:
        if num_scenes > 1:
            raise SourceError("--masks are those of one scene; leave out the other scenes")
        options["masks"] = "none" if str(masks) == "none" else masks  # the word is no path
    return options
