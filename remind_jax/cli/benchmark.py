"""`remind benchmark`: many trackers on many scenes, by the same rules, with tables at the end."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from tyro.conf import Positional, UseAppendAction, arg

from remind_jax.cli import process
from remind_jax.cli.flags import BackboneName, DetectionFlags, SamplingFlags, flags
from remind_jax.errors import ConfigError
from remind_jax.files import locked, refuse_folder
from remind_jax.printing.words import plural

if TYPE_CHECKING:
    from remind_jax.benchmark.records import Record
    from remind_jax.benchmark.scenes import Scene
    from remind_jax.benchmark.scoring import Scored
    from remind_jax.metrics.comparison import ComparisonTable

DEFAULT_FOLDER = Path("benchmarks-out")


@flags
class Benchmark:
    """Run many trackers on every scene of a data set and write tables of scores.

    Results are kept as they come: nothing that is there is done again.

    A scene that fails is reported, counted, and left behind.

    Examples:
      remind benchmark                                  twelve rendered tours
      remind benchmark DAVIS --backbone dinov3-vits16
      remind benchmark scannetpp/ --methods default remind bank
      remind benchmark scannetpp/ --detector yolo.onnx  masks of a detector
    """

    # DAVIS or ScanNet++ folder, or a folder of scenes; twelve rendered tours if left out
    root: Annotated[Positional[Path | None], arg(metavar="[DATASET_ROOT]")] = None
    # configurations, trackers or YAML files; default, remind, published, all ablations, all other
    # trackers if left out
    methods: Annotated[UseAppendAction[tuple[tuple[str, ...], ...]], arg(metavar="NAME ...")] = ()
    # only these scenes
    scenes: Annotated[UseAppendAction[tuple[tuple[str, ...], ...]], arg(metavar="NAME ...")] = ()
    detector: Path | None = None  # ONNX segmentation model; the scenes' own masks if left out
    backbone: BackboneName = "patch-statistics"
    weights: Path | None = None  # converted weights; found or fetched if left out
    feature_cache: Path | None = None  # keep features there, in the user's cache if left out
    out: Path = DEFAULT_FOLDER  # output folder, of this or an earlier benchmark
    retry_failed: bool = False  # run again what failed before
    quiet: bool = False  # say nothing but errors
    json: bool = False  # print scores as JSON on stdout
    sampling: SamplingFlags = SamplingFlags()
    detection: DetectionFlags = DetectionFlags()

    def execute(self) -> int:
        """Runs what is missing, scores everything, writes tables; returns the exit code."""
        from remind_jax.backbone.opening import open_backbone
        from remind_jax.benchmark.contenders import make_contenders
        from remind_jax.benchmark.running import Setup, run_all
        from remind_jax.benchmark.scoring import score_scene
        from remind_jax.benchmark.tables import make_tables, save_tables
        from remind_jax.detectors import OnnxDetector

        contenders = make_contenders([name for names in self.methods for name in names])
        if self.detector is not None:
            OnnxDetector(self.detector)  # else every run would fail for it
        self.detection.check_used_by(self.detector)
        inputs = (self.root, self.detector, self.weights)
        refuse_folder(self.out, inputs, ("tables", "masks", "detector"), may_hold=True)
        scenes = self._find_scenes()
        setup = Setup(
            out=self.out,
            backbone=open_backbone(self.backbone, weights=self.weights, quiet=self.quiet),
            detector=self.detector,
            detector_options=self.detection,
            sampling=self.sampling,
            feature_cache=self.feature_cache,
            retry_failed=self.retry_failed,
            is_shown=not self.quiet,
        )
        with locked(self.out):
            records = run_all(setup, scenes, contenders, self._say_record)
        runs: list[Scored] = []
        for scene in scenes:
            of_scene = [record for record in records if record.scene == scene.name]
            runs += score_scene(self.out, of_scene, scene, self.sampling)
        num_frames = sum(record.num_frames for record in records) // len(contenders)
        size = f"{plural(len(scenes), 'scene')}, {plural(num_frames, 'frame')}"
        about = f"{size}, {setup.regime}, {self.backbone}"
        titles = {contender.name: contender.title for contender in contenders}
        tables = make_tables(runs, titles, setup.regime, about)
        save_tables(tables, self.out / "tables")
        self._show(tables, runs)
        return process.FINE if any(run.strict for run in runs) else process.ERROR

    def _find_scenes(self) -> tuple[Scene, ...]:
        from remind_jax.benchmark.scenes import find_scenes, select_scenes
        from remind_jax.benchmark.tours import render_tours

        root = self.root
        if root is None:
            root = render_tours(progress=lambda name: self._say(f"rendering {name}"))
        names = tuple(name for group in self.scenes for name in group)
        chosen = select_scenes(find_scenes(root), names)
        for scene in chosen:
            if not scene.has_masks:
                self._say(f"{scene.name} has no annotations and cannot be scored; left out")
        annotated = tuple(scene for scene in chosen if scene.has_masks)
        if not annotated:
            raise ConfigError(f"no scene of '{root}' has annotations; nothing can be scored")
        return annotated

    def _show(self, tables: dict[str, ComparisonTable], runs: list[Scored]) -> None:
        from remind_jax.benchmark.tables import list_failures
        from remind_jax.metrics.scene_evaluation import without_nan

        failures = list_failures(runs)
        if self.json:
            main = next(iter(tables.values()))
            rows = {row.name: without_nan(row.scores) for row in main.rows}
            print(json.dumps({"scores": rows, "failed": failures}, indent=1))
            return
        if not self.quiet:
            for table in tables.values():
                table.print()
                print()
        for failure in failures:
            print(f"failed: {failure}", file=sys.stderr)

    def _say_record(self, record: Record, was_there: bool) -> None:
        place = f"{record.scene}, {record.contender}"
        if record.status == "failed":
            self._say(f"{place}: failed: {record.error}")
        elif not was_there and "step_ms" in record.times_ms:
            step_ms = record.times_ms["step_ms"]
            self._say(f"{place}: {record.num_frames} frames, step {step_ms:.1f} ms")

    def _say(self, sentence: str) -> None:
        if not self.quiet:
            print(sentence, file=sys.stderr, flush=True)
