"""`remind features`: looks at a scene once, so that it can be tracked often."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from typing import Annotated

from tyro.conf import Positional, arg

from remind_jax.cli import process
from remind_jax.cli.flags import (
    Assignments,
    BackboneName,
    SamplingFlags,
    load_config_with,
    quiet_defaults,
)
from remind_jax.errors import SourceError
from remind_jax.files import refuse_folder
from remind_jax.printing.terminal import print_lines


@quiet_defaults
@dataclasses.dataclass(frozen=True)
class Features:
    """Compute patch features of every frame and keep them for 'remind run'.

    What is there already is not computed again; stopped, it goes on where it was.

    Features are found again by frame, backbone, weights and size.

    Runs that look at closeups of detections need none of them (input.closeups).

    Examples:
      remind features rooms.mp4 --backbone dinov3-vits16 --cache kept/
      remind run rooms.mp4 --backbone dinov3-vits16 --feature-cache kept/
    """

    # video, folder or tar of images, DAVIS or ScanNet++ folder or tar
    source: Annotated[Positional[Path], arg(metavar="SOURCE")]
    backbone: BackboneName = "dinov3-vits16"
    weights: Path | None = None  # converted weights; found or fetched if left out
    cache: Path | None = None  # folder of features; in the user's cache folder if left out
    # configuration by name or YAML file: frames are scaled and cropped as it says
    config: Annotated[str, arg(metavar="NAME|FILE")] = "default"
    changes: Assignments = ()
    sequence: str | None = None  # which one, where a DAVIS folder holds several
    images: str | None = None  # which images of a ScanNet++ scene, e.g. iphone/rgb
    quiet: bool = False  # say nothing but errors
    json: bool = False  # print the summary as JSON
    sampling: SamplingFlags = dataclasses.field(default_factory=SamplingFlags)

    def execute(self) -> int:
        """Computes what is missing and reports; returns the exit code."""
        from rich.console import Console
        from rich.progress import track

        from remind_jax.backbone.feature_cache import (
            Tally,
            cache_features,
            default_folder,
            remove_unfinished,
        )
        from remind_jax.backbone.opening import open_backbone
        from remind_jax.masks.alignment import Alignment
        from remind_jax.sources import open_source

        frames = open_source(
            self.source,
            masks="none",
            sampling=self.sampling,
            sequence=self.sequence,
            images=self.images,
        )
        options = load_config_with(self.config, self.changes).input
        folder, tally = self.cache or default_folder(), Tally()
        refuse_folder(folder, [self.source], may_hold=True)
        backbone = cache_features(
            open_backbone(self.backbone, weights=self.weights, quiet=self.quiet), folder, tally
        )
        remove_unfinished(folder)
        console = Console(stderr=True)
        for frame in track(
            frames,
            description=f"{frames.name}: {backbone.name}",
            total=frames.num_frames,
            console=console,
            disable=self.quiet or not console.is_terminal,
            transient=True,
        ):
            if frame.image is None:
                raise SourceError(f"frame '{frame.name}' has no image to compute features of")
            alignment = Alignment.fit(
                frame.size,
                backbone.patch_px,
                max_width_px=options.max_width_px,
                center_crop=options.center_crop,
            )
            backbone.extract(alignment.align_image(frame.image)[None])
        facts = {
            "folder": str(folder),
            "backbone": backbone.name,
            "fingerprint": backbone.fingerprint,
            "computed": tally.num_computed,
            "found": tally.num_found,
        }
        if self.json:
            print(json.dumps(facts, indent=1))
        elif not self.quiet:
            line = (
                f"{folder}: features of {tally.num_computed} frames computed, of "
                f"{tally.num_found} found, backbone {backbone.name}"
            )
            print_lines([line])
        return process.FINE
