"""`remind calibrate`: thresholds of the paper's tracker for the features of any backbone."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

from tyro.conf import Positional, arg

from remind_jax.cli.flags import BackboneName, DetectionFlags, SamplingFlags, flags
from remind_jax.cli.run import Layout, scene_options
from remind_jax.errors import SourceError
from remind_jax.files import refuse_file
from remind_jax.printing.terminal import print_lines
from remind_jax.session.progress import RunLine

_SHOWN = ("matching.match", "matching.min_visual", "appearance.duplicate")


@flags
class Calibrate:
    """Fit the thresholds of the paper's tracker ('--config remind') to a backbone.

    Takes scenes with masks, or any video and a detector; nothing has to be labeled.

    Runs with '--config remind' and this backbone find the profile.

    Examples:
      remind calibrate rooms/ --backbone dinov2-vits14
      remind calibrate rooms.mp4 --detector m.onnx --backbone dinov2-vits14
      remind calibrate a/ b/ --backbone onnx:encoder.onnx
      remind calibrate rooms/ --backbone dinov2-vits14 --out dinov2.yaml
    """

    # folders with images and masks, or videos for a detector; a minute with several
    # objects in view is enough
    sources: Annotated[Positional[tuple[Path, ...]], arg(metavar="SCENE ...")]
    backbone: BackboneName = "patch-statistics"
    weights: Path | None = None  # converted weights; found or fetched if left out
    feature_cache: Path | None = None  # keep features there and reuse them
    masks: Path | None = None  # of the scene, if there is one only and its layout holds none
    detector: Path | None = None  # ONNX segmentation export, instead of masks
    out: Path | None = None  # YAML file to write; where runs look for it if left out
    seed: int = 0  # of the choice of what is compared
    quiet: bool = False  # say nothing but errors
    json: bool = False  # print the summary as JSON
    sampling: SamplingFlags = SamplingFlags()
    detection: DetectionFlags = DetectionFlags()
    layout: Layout = Layout()

    def execute(self) -> None:
        """Calibrates and reports."""
        if not self.sources:
            raise SourceError("name the scenes to calibrate on: folders with masks")
        self.detection.check_used_by(self.detector)
        more = scene_options(self.layout, self.masks, len(self.sources))
        if self.out is not None:
            inputs = (*self.sources, self.masks, self.weights, self.detector)
            refuse_file(self.out, [path for path in inputs if path is not None])
        from remind_jax.backbone.opening import obtain_named
        from remind_jax.calibration import calibrate

        obtain_named(self.backbone, self.weights, quiet=self.quiet)
        with RunLine(self.backbone, None, is_shown=not self.quiet):
            made = calibrate(
                list(self.sources),
                backbone=self.backbone,
                weights=self.weights,
                feature_cache=self.feature_cache,
                detector=self.detector,
                detector_options=None if self.detector is None else self.detection,
                out=self.out,
                seed=self.seed,
                sampling=self.sampling,
                **more,
            )
        what = made.made_for
        if self.json:
            facts = {
                "file": str(made.path),
                "backbone": what.backbone,
                "fingerprint": what.fingerprint,
                "evidence": what.evidence,
                "same": what.same,
                "other": what.other,
                "thresholds": made.thresholds,
            }
            print(json.dumps(facts, indent=1))
        elif not self.quiet:
            values = ", ".join(f"{name} {made.thresholds[name]:.2f}" for name in _SHOWN)
            use = "used by --config remind with this backbone"
            if self.out is not None:
                use = f"use it with --config {made.path}"
            print_lines(
                f"{what.backbone}: {what.same} comparisons of an object with itself, "
                f"{what.other} of two ({what.evidence}): {values}",
                f"{made.path}: {use}",
            )
