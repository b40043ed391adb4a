"""`remind demo`: renders a tour, tracks it and says what was recovered."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from tyro.conf import arg

from remind_jax.cli import process
from remind_jax.cli.flags import Assignments, flags, load_config_with
from remind_jax.cli.progress import RunDisplay
from remind_jax.cli.run import track
from remind_jax.cli.summary import print_summary, summary_facts
from remind_jax.errors import OutputError
from remind_jax.printing.terminal import print_table

if TYPE_CHECKING:
    from remind_jax.outputs.result import Result

NAME = "demo"
SCENE_NAME = "scene"  # what was rendered, in the output folder


@flags
class Demo:
    """Render a tour through two rooms, track its objects and compare with the truth.

    Out of a bright room full of look-alikes, and back to them in the dark.

    Examples:
      remind demo
      remind demo --seed 3 --out other_rooms
      remind demo --config remind                   the tracker of the paper
    """

    # output folder; an earlier run there is replaced; 'scene' in it is what was rendered
    out: Path = Path("remind_demo")
    seed: int = 8  # another seed gives other rooms, objects and paths
    # configuration by name (see 'remind config list') or YAML file
    config: Annotated[str, arg(metavar="NAME|FILE")] = "default"
    # as in 'remind run'; that of the configuration if left out
    tracker: Annotated[str | None, arg(metavar="NAME")] = None
    changes: Assignments = ()
    trace: bool = False  # keep why everything was decided, for the report and 'remind explain'
    quiet: bool = False  # say nothing but errors
    json: bool = False  # print the summary as JSON on stdout

    def execute(self) -> int:
        """Renders, tracks, evaluates and prints; returns the exit code."""
        from remind_jax.metrics import evaluate_tracks
        from remind_jax.outputs.presence import MIN_ABSENCE_FRAMES
        from remind_jax.outputs.result import COMPARISON_HEADS
        from remind_jax.outputs.store import DETECTIONS_NAME
        from remind_jax.outputs.writer import add_comparison
        from remind_jax.synthetic import demo_options, make_scene, record_davis

        present = {path.name for path in self.out.iterdir()} if self.out.is_dir() else set()
        if present - {SCENE_NAME} and DETECTIONS_NAME not in present:
            raise OutputError(
                f"the output folder '{self.out}' is not empty and holds no earlier run; choose "
                "another one with --out"
            )
        config = load_config_with(self.config, self.changes, tracker=self.tracker)
        options = demo_options(self.seed)
        scene = make_scene(options)
        display = RunDisplay(NAME, options.frames, is_shown=not self.quiet)
        result = track(
            display,
            self.out,
            source=record_davis(scene, self.out / SCENE_NAME),
            config=config,
            trace=self.trace,
            overwrite=True,
            name=NAME,
            image_fps=options.fps,
        )
        evaluation = evaluate_tracks(
            result.tracks, name=NAME, min_absence_frames=MIN_ABSENCE_FRAMES
        )
        result = add_comparison(self.out, result, compare(result, evaluation.scores()))
        if self.json:
            facts = summary_facts(result, self.out) | evaluation.to_json()
            print(json.dumps(facts, indent=1))
        elif not self.quiet:
            print_summary(result, self.out)
            print_table(
                [COMPARISON_HEADS, *result.comparison], "Compared with the truth", is_text=(0, 3)
            )
        return process.FINE if result.complete else process.stopped_by(display.signal)


def compare(result: Result, scores: Mapping[str, float]) -> tuple[tuple[str, ...], ...]:
    """What a tour gave back of its truth, and what each number means (`Result.comparison`)."""
    from remind_jax.outputs.presence import MIN_ABSENCE_FRAMES

    def share(name: str) -> str:
        return "-" if math.isnan(scores[name]) else f"{100 * scores[name]:.1f} %"

    def count(name: str) -> str:
        return f"{scores[name]:.0f}"

    found = result.summary()
    away = f"back in view after {MIN_ABSENCE_FRAMES} frames or more"
    return (
        ("IDF1", share("IDF1"), "", "detections with the id of their object"),
        ("recovery", share("Recovery"), "", "returns that got the old identity back"),
        ("hard recovery", share("HardRecovery"), "", "the same, in their first frame"),
        ("returns", str(found["returns"]), count("Opportunities"), away),
        ("identities", str(found["identities"]), count("GT_IDs"), "best: as many as true objects"),
    )
