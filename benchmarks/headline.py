"""The figures that several pages lead with: measured, kept in one file, written where they stand.

    python benchmarks/headline.py                  four rendered tours and starts: `make figures`
    python benchmarks/headline.py --clips FOLDER   and real clips (see `realvideo.py`)
    python benchmarks/headline.py --write-only     the pages, from what is in headline.json

The first tour is that of `remind demo`; the others are of seeds on which nothing may be tuned. A
start is what a fresh process takes until its first identity (640x480, see `cold_start.py`): CPU
seconds with nothing kept from earlier processes and with the programs that they left, and the
largest memory. What is not measured this time stays in headline.json as it is.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import sys
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from benchmarks import cold_start, realvideo
from benchmarks.clips import Judged, find_clips
from benchmarks.field_peers.environments import add_peer_options, chosen_peers
from benchmarks.pages import fill_file
from remind_jax.backbone import get_backbone
from remind_jax.benchmark.contenders import make_contenders
from remind_jax.benchmark.running import Setup, run_all
from remind_jax.benchmark.scenes import find_scenes
from remind_jax.benchmark.scoring import by_contender, read_truth, score, summarize
from remind_jax.benchmark.tours import FIRST_SEED, render_tours
from remind_jax.metrics import Column, ComparisonTable, Row
from remind_jax.metrics.scene_evaluation import without_nan
from remind_jax.synthetic import demo_options

ROOT = Path(__file__).resolve().parent.parent
DATA = Path(__file__).with_suffix(".json")
PAGES = (ROOT / "README.md", ROOT / "docs" / "index.md", ROOT / "docs" / "your_video.md")
CONTENDERS = ("default", "remind", "bank")
STARTED = ("default", "remind")
OF_CLIPS = ("default", "remind", "bank", "bank-closeups", "running-mean")
_SHORT = (
    "IDF1",
    Column("Recovery", "percent", "higher", label="Returns recovered"),
    Column("HardRecovery", "percent", "higher", label="in the first frame"),
)
_TOURS = (
    "IDF1",
    Column("IDs", "count", label="Identities"),
    "GT_IDs",
    *_SHORT[1:],
    Column("undecided", "percent", "lower", label="Undecided"),
    Column("empty_cpu_s", "seconds", "lower", label="First start, CPU s"),
    Column("warm_cpu_s", "seconds", "lower", label="Later starts"),
    Column("empty_peak_gb", "number", "lower", label="Peak GB"),
)
_CLIPS = (
    "IDF1",
    "AssA",
    Column("recovered", "count", "higher", label="recovered"),
    Column("kept", "count", "higher", label="kept"),
    Column("at_once", "count", "higher", label="in the first frame"),
    Column("merged", "count", "lower", label="merged"),
)
_KEPT = sorted({one if isinstance(one, str) else one.name for one in (*_TOURS, *_CLIPS)})
_SIZES = ("returns", "pairs", "IDs", "GT_IDs")
Scores = Mapping[str, Mapping[str, float | None]]  # by title, then by name of the score


def tables_of(data: Mapping[str, Any]) -> dict[str, str]:
    """Every generated table, by its mark."""
    return {
        "figures:tours": _table(data["tours"], _TOURS),
        "figures:tours-short": _table(data["tours"], _SHORT),
        "figures:clips": _pooled(data["clips"]),
        "figures:turns": _by_clip(data["turns"]),
        "figures:people": _by_clip(data["people"]),
    }


def _table(scores: Scores, columns: Sequence[str | Column]) -> str:
    rows = [
        Row(title, {name: v for name, v in own.items() if v is not None})
        for title, own in scores.items()
    ]
    return ComparisonTable(rows, columns).to_markdown()


def _pooled(scores: Scores) -> str:
    """All clips pooled; of every tracker of others the setting that fares best."""
    best: dict[str, str] = {}
    for title, own in scores.items():
        tracker = title.partition(" (")[0] if _is_peer(title) else title
        if tracker not in best or _idf1(own) > _idf1(scores[best[tracker]]):
            best[tracker] = title
    sizes = next(iter(scores.values()))
    heads = {"recovered": f"recovered of {sizes['returns']:.0f}"}
    heads |= {"merged": f"Pairs merged of {sizes['pairs']:.0f}"}
    columns = [
        dataclasses.replace(one, label=heads.get(one.name, one.label))
        if isinstance(one, Column)
        else one
        for one in _CLIPS
    ]
    return _table({title: scores[title] for title in best.values()}, columns)


def _idf1(scores: Mapping[str, float | None]) -> float:
    return scores["IDF1"] or 0.0


def _is_peer(title: str) -> bool:
    return title.endswith((", published", ", open", ", for ever"))


def _by_clip(scores: Scores) -> str:
    names = next(iter(scores.values()), {})
    return _table(scores, [Column(name, "percent", "higher") for name in names])


def measure_tours(repeats: int) -> dict[str, dict[str, float | None]]:
    """Every contender on the rendered tours, pooled; starts of some."""
    # First: the peak of a process begins with that of the one that started it.
    starts = list(cold_start.measure(list(STARTED), repeats))
    seeds = (demo_options().seed, *range(FIRST_SEED + 100, FIRST_SEED + 103))
    options = tuple(
        dataclasses.replace(demo_options(seed), name=f"demo-{seed}" if number else "demo")
        for number, seed in enumerate(seeds)
    )
    # Into the user's cache folder, where they are not there yet.
    folder = render_tours(tours=options, progress=lambda name: say(f"rendering {name}"))
    scenes = tuple(find_scenes(folder))
    contenders = make_contenders(CONTENDERS)
    found: dict[str, dict[str, float]] = {}
    with tempfile.TemporaryDirectory() as scratch:
        out = Path(scratch)
        eyes = get_backbone("patch-statistics")
        setup = Setup(out, eyes, feature_cache=out / "features", is_shown=False)
        records = run_all(setup, scenes, contenders, lambda one, _: say(_describe(one)))
        truths = {scene.name: read_truth(scene) for scene in scenes}
        runs = [score(out, record, truths[record.scene]) for record in records]
    for name, own in by_contender(runs).items():
        if errors := [run.error for run in own if run.error]:
            raise SystemExit(f"{name}: {errors[0]}")
        found[name] = dict(summarize(own)[0])
        found[name]["undecided"] = 1 - found[name]["FirmShare"]
    for row in starts:
        config, case = row["name"].split(", ", 1)
        say(f"{row['name']}: {row['cpu_s']:.1f} CPU s")
        found[config] |= {f"{case}_{k}": float(v) for k, v in row.items() if k != "name"}
    return {one.title: without_nan(_kept(found[one.name])) for one in contenders}


def measure_clips(given: argparse.Namespace) -> dict[str, Scores]:
    """On real clips: every contender and peer, and what the default gains by options."""
    clips = find_clips(given.clips)
    with tempfile.TemporaryDirectory() as folder:
        judged = realvideo.judge_contenders(clips, OF_CLIPS, (), Path(folder))
        names = chosen_peers(given.peers)
        peers, absent = realvideo.judge_peers(clips, names, Path(folder), given.environments)
        turns, people = realvideo.judge_turns(clips, Path(folder))
    for name, why in absent.items():
        say(f"{name} is absent: {why}")
    as_it_is = {"as it is": next(iter(judged.values()))}
    return {
        "clips": {
            title: without_nan(_kept(realvideo.row_of(title, list(own.values())).scores))
            for title, own in (judged | peers).items()
        },
        "turns": _idf1_by_clip(as_it_is | turns),
        "people": _idf1_by_clip(people),
    }


def _idf1_by_clip(judged: Mapping[str, Mapping[str, Judged]]) -> Scores:
    return {
        title: {clip: round(one.evaluation.scores()["IDF1"], 4) for clip, one in own.items()}
        for title, own in judged.items()
    }


def _kept(scores: Mapping[str, float]) -> dict[str, float]:
    return {k: round(scores[k], 4) for k in (*_KEPT, *_SIZES) if k in scores}


def _describe(record: Any) -> str:
    return f"{record.scene}, {record.contender}: {record.error or record.status}"


def say(sentence: str) -> None:
    print(sentence, file=sys.stderr, flush=True)


def main() -> None:
    """Parses the command line, measures, and writes data and pages."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--write-only", action="store_true", help="measure nothing")
    parser.add_argument("--clips", type=Path, help="folder of real clips")
    parser.add_argument("--clips-only", action="store_true", help="measure no tours and starts")
    parser.add_argument("--repeats", type=int, default=1, help="of every start")
    add_peer_options(parser)
    given = parser.parse_args()
    data = json.loads(DATA.read_text())
    if not given.write_only:
        if not given.clips_only:
            data["tours"] = measure_tours(given.repeats)
        if given.clips is not None:
            found = measure_clips(given)
            data |= found | {"clips": data["clips"] | found["clips"]}
        DATA.write_text(json.dumps(data, indent=1) + "\n")
    tables = tables_of(data)
    for page in PAGES:
        fill_file(page, tables)
    print("\n\n".join(tables.values()))


if __name__ == "__main__":
    main()
