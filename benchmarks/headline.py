"""The figures that the README leads with: the default tracker, the paper's method and a baseline.

    python benchmarks/headline.py                     four rendered tours: `make figures`
    python benchmarks/headline.py --data FOLDER       and the annotated sequences of a folder
    python benchmarks/headline.py --start default remind --json figures.json

The first tour is that of `remind demo`; the others are of seeds on which nothing may be tuned.
Columns: detections with the one right identity of their object (IDF1); identities given, and
objects of the truth; returns that got the old identity back, also in their first frame; detections
without an identity. For the configurations that `--start` names also what a fresh process takes
until its first identity (640x480, see `cold_start.py`): CPU seconds with nothing kept from earlier
processes and with the programs that they left, and the largest memory.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import sys
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from benchmarks import cold_start
from remind_jax.backbone import get_backbone
from remind_jax.benchmark.contenders import make_contenders
from remind_jax.benchmark.records import Record
from remind_jax.benchmark.running import Setup, run_all
from remind_jax.benchmark.scenes import Scene, find_scenes
from remind_jax.benchmark.scoring import by_contender, read_truth, score, summarize
from remind_jax.benchmark.tours import FIRST_SEED, render_tours
from remind_jax.metrics.columns import Column
from remind_jax.metrics.comparison import ComparisonTable, Row
from remind_jax.metrics.scene_evaluation import without_nan
from remind_jax.synthetic import demo_options

CONTENDERS = ("default", "remind", "bank")
SEEDS = (demo_options().seed, *range(FIRST_SEED + 100, FIRST_SEED + 103))
SCORES = (
    "IDF1",
    Column("IDs", "count", label="Identities"),
    "GT_IDs",
    Column("Recovery", "percent", "higher", label="Returns recovered"),
    Column("HardRecovery", "percent", "higher", label="in the first frame"),
    Column("undecided", "percent", "lower", label="Undecided"),
)
STARTS = (
    Column("empty_cpu_s", "seconds", "lower", label="First start, CPU s"),
    Column("warm_cpu_s", "seconds", "lower", label="Later starts"),
    Column("empty_peak_gb", "number", "lower", label="Peak GB"),
)
Starts = Mapping[str, Mapping[str, float]]  # scores by the name of a configuration


def find_tours() -> tuple[Scene, ...]:
    """The tours, rendered into the user's cache folder if they are not there."""
    tours = tuple(
        dataclasses.replace(demo_options(seed), name=f"demo-{seed}" if number else "demo")
        for number, seed in enumerate(SEEDS)
    )
    return find_scenes(render_tours(tours=tours, progress=lambda name: say(f"rendering {name}")))


def compare(scenes: Sequence[Scene], title: str, starts: Starts) -> ComparisonTable:
    """Runs every contender on every scene and adds up over scenes."""
    contenders = make_contenders(CONTENDERS)
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder)
        eyes = get_backbone("patch-statistics")
        setup = Setup(out, eyes, feature_cache=out / "features", is_shown=False)
        records = run_all(setup, tuple(scenes), contenders, say_record)
        truths = {scene.name: read_truth(scene) for scene in scenes}
        runs = [score(out, record, truths[record.scene]) for record in records]
    titles = {contender.name: contender.title for contender in contenders}
    rows = []
    for name, own in by_contender(runs).items():
        scores, _ = summarize(own)
        if scores:
            scores["undecided"] = 1 - scores["FirmShare"]
        note = "; ".join(run.error for run in own if run.error)
        rows.append(Row(titles[name], {**scores, **starts.get(name, {})}, note=note))
    columns = SCORES + STARTS if starts else SCORES
    return ComparisonTable(rows, columns, title=f"{title}: {', '.join(s.name for s in scenes)}")


def measure_starts(configs: Sequence[str], repeats: int) -> Starts:
    """What fresh processes take until their first identity."""
    starts: dict[str, dict[str, float]] = {config: {} for config in configs}
    for row in cold_start.measure(list(configs), repeats):
        config, case = row["name"].split(", ", 1)
        say(f"{row['name']}: {row['cpu_s']:.1f} CPU s")
        values = {k: float(v) for k, v in row.items() if k != "name"}
        starts[config] |= {f"{case}_{name}": value for name, value in values.items()}
    return starts


def measure(data: Path | None, start: Sequence[str], repeats: int) -> Iterator[ComparisonTable]:
    yield compare(find_tours(), "Rendered tours", measure_starts(start, repeats))
    if data is not None:
        annotated = [scene for scene in find_scenes(data) if scene.has_masks]
        yield compare(annotated, str(data), {})


def say(sentence: str) -> None:
    print(sentence, file=sys.stderr, flush=True)


def say_record(record: Record, was_there: bool) -> None:
    say(f"{record.scene}, {record.contender}: {record.error or record.status}")


def main() -> None:
    """Parses the command line, measures and prints."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--data", type=Path, help="folder of annotated sequences")
    parser.add_argument("--start", nargs="*", default=["default"], metavar="CONFIG")
    parser.add_argument("--repeats", type=int, default=1, help="of every start")
    parser.add_argument("--json", type=Path)
    given = parser.parse_args()
    kept = []
    for table in measure(given.data, given.start, given.repeats):
        print(table.to_markdown(), flush=True)
        rows = {row.name: without_nan(row.scores) for row in table.rows}
        kept.append({"title": table.title, "rows": rows})
    if given.json is not None:
        given.json.write_text(json.dumps(kept, indent=1))


if __name__ == "__main__":
    main()
