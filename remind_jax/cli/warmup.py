"""`remind warmup`: compiles ahead what later runs and robots will need, and keeps it."""

from __future__ import annotations

import re
import reprlib
from pathlib import Path
from typing import Annotated

from tyro.conf import Positional, arg

from remind_jax.cli.flags import Assignments, BackboneName, flags, load_config_with
from remind_jax.errors import ConfigError, OutputError
from remind_jax.session.progress import RunLine
from remind_jax.settings.ranges import check_option
from remind_jax.static import MOST_DETECTIONS, MOST_OBJECTS

_MAX_SIDE_PX = 16_384


@flags
class Warmup:
    """Compile ahead for frames of some sizes, so that later starts wait less.

    What needs more than that is compiled when it comes.

    Kept in the user's cache folder; the variable REMIND_PROGRAMS names another.

    Examples:
      remind warmup 640x480
      remind warmup 640x480 1280x720 --detections 60 --objects 500
      remind warmup 1280x720 --backbone dinov3-vits16 --weights dinov3.safetensors
    """

    # width x height in pixels, one or several
    sizes: Annotated[Positional[tuple[str, ...]], arg(metavar="WIDTHxHEIGHT")]
    detections: int = 32  # in a frame
    objects: int = 128  # in memory
    backbone: BackboneName = "patch-statistics"
    weights: Path | None = None  # converted weights; found or fetched if left out
    # configuration by name (see 'remind config list') or YAML file
    config: Annotated[str, arg(metavar="NAME|FILE")] = "default"
    tracker: Annotated[str | None, arg(metavar="NAME")] = None  # as for 'remind run'
    changes: Assignments = ()
    quiet: bool = False  # say nothing but errors

    def execute(self) -> None:
        """Compiles and says how long it took."""
        check_option("detections", self.detections, 0, MOST_DETECTIONS)
        check_option("objects", self.objects, 0, MOST_OBJECTS)
        sizes = [_parse_size(size) for size in self.sizes]
        config = load_config_with(self.config, self.changes, tracker=self.tracker)
        from remind_jax.backbone.opening import open_backbone
        from remind_jax.compiled.kept import VARIABLE, program_folder
        from remind_jax.session.live import Tracker

        backbone = open_backbone(self.backbone, weights=self.weights, quiet=self.quiet)
        for width, height in sizes:
            tracker = Tracker(config, backbone)
            with RunLine(f"{width}x{height}", None, is_shown=not self.quiet):
                seconds = tracker.warm_up((height, width), num_objects=self.objects)
                # Later processes start with the least room, and double it.
                while (room := tracker.static.num_detections) < self.detections:
                    seconds += tracker.warm_up(
                        (height, width), num_objects=self.objects, num_detections=room + 1
                    )
            if not self.quiet:
                most_objects = max(self.objects, tracker.static.num_objects)
                print(
                    f"{width}x{height}: ready after {seconds:.1f} s, for up to {room} detections "
                    f"in a frame and {most_objects} objects"
                )
        folder = program_folder()
        if folder is not None and not (folder.is_dir() and any(folder.iterdir())):
            raise OutputError(
                f"nothing could be kept in '{folder}'; set {VARIABLE} to a folder that can be "
                "written to and has room"
            )
        if not self.quiet:
            print(f"kept in {folder}" if folder else f"nothing is kept, as {VARIABLE} says")


def _parse_size(text: str) -> tuple[int, int]:
    """Width and height."""
    found = re.fullmatch(r"([0-9]{1,6})x([0-9]{1,6})", text)
    width, height = (int(found[1]), int(found[2])) if found else (0, 0)
    if not (0 < width <= _MAX_SIDE_PX and 0 < height <= _MAX_SIDE_PX):
        raise ConfigError(
            f"{reprlib.repr(text)} is no frame size; write WIDTHxHEIGHT in pixels, as 640x480, at "
            f"most {_MAX_SIDE_PX} each"
        )
    return width, height
