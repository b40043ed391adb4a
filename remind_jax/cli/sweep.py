"""`remind sweep`: many settings on many annotated scenes, in one table."""

from __future__ import annotations

import dataclasses
import itertools
import json
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from tyro.conf import Positional, UseAppendAction, arg

from remind_jax.cli import process
from remind_jax.cli.flags import BackboneName, SamplingFlags, TrackerName, flags
from remind_jax.cli.progress import follow_sweep
from remind_jax.cli.run import DEFAULT_FOLDER, Layout, scene_options
from remind_jax.errors import ConfigError, SweepError
from remind_jax.files import refuse_folder, writing
from remind_jax.printing.terminal import print_lines, print_markdown
from remind_jax.printing.words import plural
from remind_jax.settings.ranges import check_option

if TYPE_CHECKING:
    from remind_jax.sweeps import SweepResult
    from remind_jax.sweeps.bench import SceneBench
    from remind_jax.sweeps.result import Standing
    from remind_jax.sweeps.settings import Setting, Value
    from remind_jax.sweeps.worker import Progress

SUMMARY_FILE, TABLE_FILE = "summary.md", "rows.csv"

Ranges = Annotated[
    UseAppendAction[tuple[tuple[str, ...], ...]],
    arg(
        name="set",
        metavar="KEY=VALUES ...",
        help="thresholds and their values: 0.5,0.6 or true,false or first:last:step; two numbers "
        "are the ends of a range to draw from with --random, --search and --sensitivity",
    ),
]


@flags
class Sweep:
    """Score many settings on annotated scenes: a table, the best, what they trade.

    A row scores the run with that setting; the first changes nothing.

    Rows are written as they come; the same command again goes on where it stopped.

    Examples:
      remind sweep rooms/ --set decision.new=0:2:0.5
      remind sweep a/ --set decision.new=0,2.5 layout.weight=0,1.2 --random 256
      remind sweep a/ b/ c/ --set decision.new=0.0,2.5 --search tpe --number 128
      remind sweep a/ b/ c/ --search nsga2 --set ... --objectives IDF1 Firm
      remind sweep a/ b/ c/ --sensitivity           thresholds that matter most
      remind sweep rooms/ --config remind --set matching.match=0.5:0.8:0.05
      remind sweep a/ b/ c/ --settings mine.csv --workers 8
    """

    # folders whose masks say which object they show
    sources: Annotated[Positional[tuple[Path, ...]], arg(metavar="SCENE ...")]
    ranges: Ranges = ()
    random: int | None = None  # draw so many settings instead of trying all combinations
    settings: Path | None = None  # CSV with one column per threshold, or JSON with a list
    # propose settings by what was found (needs Optuna); nsga2 for several objectives
    search: Literal["tpe", "nsga2"] | None = None
    sensitivity: bool = False  # move every threshold by itself: how much each matters
    # settings of a search, values of each threshold for --sensitivity; chosen if left out
    number: int | None = None
    at_once: int = 16  # settings that a search proposes together
    objectives: tuple[str, ...] = ("IDF1",)  # what a search makes best
    metric: str | None = None  # what is best; the first of the objectives if left out
    seed: int = 0  # of everything random
    config: Annotated[str, arg(metavar="NAME|FILE")] = "default"  # what a setting does not name
    tracker: TrackerName = None
    backbone: BackboneName = "patch-statistics"
    weights: Path | None = None  # converted weights; found or fetched if left out
    feature_cache: Path | None = None  # keep features there and reuse them
    masks: Path | None = None  # of the scene, if there is one only and its layout holds none
    memory_gib: float = 2.0  # that the compiled program may take, on each device
    delay: int | None = None  # frames that answers wait, as in 'remind run'; 0: as it is live
    batch: int | None = None  # settings side by side; chosen by memory if left out
    workers: int | None = None  # processes (needs Ray); this one does all if left out
    cluster: Annotated[str | None, arg(metavar="ADDRESS")] = None  # of a Ray cluster, e.g. auto
    # folder of rows.jsonl, rows.csv and summary.md; runs/sweep if left out
    out: Annotated[Path | None, arg(aliases=("-o",))] = None
    top: int = 10  # settings shown
    quiet: bool = False  # say nothing but errors
    json: bool = False  # print the summary as JSON on stdout
    sampling: SamplingFlags = SamplingFlags()
    layout: Layout = Layout()

    def execute(self) -> int:
        """Sweeps, writes the tables, prints the summary; returns the exit code."""
        space, settings = self._check()
        out = self.out or DEFAULT_FOLDER / "sweep"
        from remind_jax.backbone.opening import obtain_named
        from remind_jax.sweeps.records import FILE_NAME

        inputs = (*self.sources, self.masks, self.settings, self.weights)
        refuse_folder(out, inputs, (FILE_NAME,), may_hold=True)
        obtain_named(self.backbone, self.weights, quiet=self.quiet)
        with follow_sweep(is_shown=not self.quiet) as follow:
            bench = self._open(out, follow)
            result, sections = self._sweep(bench, space, settings)
        if not result.complete and not result.rows:
            return process.INTERRUPTED
        sections = [self._describe(result), *sections]
        result.to_csv(out / TABLE_FILE)
        with writing(out / SUMMARY_FILE):
            (out / SUMMARY_FILE).write_text("\n\n".join(sections) + "\n", encoding="utf-8")
        if self.json:
            print(json.dumps(self._facts(result, out), indent=1))
        elif not self.quiet:
            print_markdown("\n\n".join(sections))
            print_lines("", f"All {len(result.settings)} settings: {out / TABLE_FILE}")
        return process.FINE if result.complete else process.INTERRUPTED

    @property
    def _best_by(self) -> str:
        return self.metric or self.objectives[0]

    @property
    def _traded(self) -> tuple[str, ...]:
        """Two scores that are laid against each other."""
        return self.objectives if len(self.objectives) == 2 else ("IDF1", "Firm")

    def _check(self) -> tuple[dict[str, list[Value]], list[Setting]]:
        """What is to be varied, and the settings to try if these are known before any work."""
        if not self.sources:
            raise SweepError("name the scenes to sweep over: folders with masks")
        from remind_jax.sweeps import bench as limits
        from remind_jax.sweeps.result import sign_of
        from remind_jax.sweeps.settings import MAX_SETTINGS

        for name, least, most in (
            ("random", 1, MAX_SETTINGS),
            ("number", 1, MAX_SETTINGS),
            ("at_once", 1, MAX_SETTINGS),
            ("top", 1, MAX_SETTINGS),
            ("seed", 0, 2**32 - 1),
            ("batch", 1, limits.MAX_BATCH),
            ("workers", 1, limits.MAX_WORKERS),
            ("memory_gib", 1e-3, limits.MAX_GIB),
        ):
            value = getattr(self, name)
            if value is not None:
                check_option(name, value, least, most, whole=name != "memory_gib")
        for name in (self._best_by, *self.objectives):
            sign_of(name)
        if self.number is not None and not (self.search or self.sensitivity):
            raise SweepError("--number is for --search and --sensitivity; give one, or --random N")
        if self.objectives != ("IDF1",) and not self.search:
            raise SweepError("--objectives are what --search looks for; give --metric, or --search")
        ways = [self.random, self.settings, self.search, self.sensitivity or None]
        if sum(way is not None for way in ways) > 1:
            raise SweepError(
                "--random, --settings, --search and --sensitivity exclude each other; give one"
            )
        space = _parse_space(self.ranges)
        if self.settings is not None and space:
            raise SweepError("--settings and --set exclude each other; give one of them")
        if not (space or self.settings or self.sensitivity):
            raise SweepError(
                "there is nothing to sweep over; give --set KEY=VALUES, for example "
                "--set decision.new=0:2:0.5, or --settings FILE"
            )
        from remind_jax.sweeps import grid, read_settings

        if self.settings is not None:
            return space, read_settings(self.settings)
        is_grid = not (self.random or self.search or self.sensitivity)
        return space, grid(space) if is_grid else []

    def _open(self, out: Path, progress: Callable[[Progress], None]) -> SceneBench:
        from remind_jax.sweeps.bench import SceneBench

        more = scene_options(self.layout, self.masks, len(self.sources))
        return SceneBench(
            list(self.sources),
            config=self.config,
            tracker=self.tracker,
            backbone=self.backbone,
            weights=self.weights,
            feature_cache=self.feature_cache,
            sampling=self.sampling,
            delay=self.delay,
            memory_gib=self.memory_gib,
            batch=self.batch,
            out=out,
            progress=progress,
            workers=self.workers,
            cluster=self.cluster,
            keep_scenes=self.search is not None or self.sensitivity,
            **more,
        )

    def _sweep(
        self, bench: SceneBench, space: dict[str, list[Value]], settings: list[Setting]
    ) -> tuple[SweepResult, list[str]]:
        """Scores settings as asked for; gives what is to be said about them beside the result."""
        from remind_jax.sweeps import draw
        from remind_jax.sweeps.cross_validation import cross_validate
        from remind_jax.sweeps.search import GIVEN, search
        from remind_jax.sweeps.sensitivity import curves_to_markdown, move_one_at_a_time

        if self.search is not None:
            result = search(
                bench,
                space,
                number=self.number or 128,
                at_once=self.at_once,
                sampler=self.search,
                objectives=self.objectives,
                seed=self.seed,
            )
            return result, []
        if self.sensitivity:
            curves, result = move_one_at_a_time(
                bench, space or None, number=self.number or 7, metric=self._best_by
            )
            return result, [f"## One threshold at a time\n\n{curves_to_markdown(curves)}"]
        if self.random is not None:
            settings = draw(bench.complete_space(space), self.random, self.seed, bench.find_fault)
        result = bench.run([GIVEN, *settings])
        if len(bench.scenes) < 2 or not result.complete:
            return result, []
        try:
            told = cross_validate(result, self._best_by).to_markdown()
        except SweepError as error:
            told = f"Not possible: {error}."
        return result, [f"## Chosen on the other scenes\n\n{told}"]

    def _describe(self, result: SweepResult) -> str:
        best = result.best(self._best_by, self.top)
        scenes = ", ".join(result.scenes)
        nothing = f"No scene has a {self._best_by} to choose by."
        parts = [
            f"# {plural(len(result.settings), 'setting')} on {plural(len(result.scenes), 'scene')}",
            f"Scenes: {scenes}. Means over scenes. Settings were chosen by the same scenes that "
            "they are reported on here.",
            f"## Best {self._best_by}\n\n{result.to_markdown(best) if best else nothing}",
            f"## As it stands\n\n{result.to_markdown(_given(result))}",
            f"## {' against '.join(self._traded)}\n\n"
            + result.to_markdown(result.pareto(*self._traded)),
        ]
        return "\n\n".join(parts)

    def _facts(self, result: SweepResult, out: Path) -> dict[str, Any]:
        return {
            "settings": len(result.settings),
            "scenes": list(result.scenes),
            "metric": self._best_by,
            "best": _records(result.best(self._best_by, self.top)),
            "as_it_stands": _records(_given(result)),
            "pareto": _records(result.pareto(*self._traded)),
            "batch": result.batch,
            "program_bytes": result.program_bytes,
            "complete": result.complete,
            "out": str(out),
        }


def _records(standings: list[Standing]) -> list[dict[str, Any]]:
    from remind_jax.metrics.evaluation import without_nan

    return [{**dataclasses.asdict(one), "scores": without_nan(one.scores)} for one in standings]


def _given(result: SweepResult) -> list[Standing]:
    """The configuration as it stands, if it was run."""
    return [standing for standing in result.standings() if not standing.setting][:1]


def _parse_space(ranges: tuple[tuple[str, ...], ...]) -> dict[str, list[Value]]:
    from remind_jax.sweeps import parse_values

    space: dict[str, list[Value]] = {}
    for text in itertools.chain(*ranges):
        name, equals, values = text.partition("=")
        if not equals or not name:
            raise SweepError(
                f"{text!r} gives no values; write --set KEY=VALUES, for example "
                "--set decision.new=0:2:0.5"
            )
        if name in space:
            raise SweepError(f"--set gives values of {name!r} twice; give them once")
        try:
            space[name] = parse_values(values)
        except ConfigError as error:
            raise SweepError(f"--set {name}: {error}") from error
    return space
