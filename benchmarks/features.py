"""What features are worth to a tracker: every backbone with every method on annotated sequences.

    python benchmarks/features.py ROOT --backbone patch-statistics --backbone onnx:encoder.onnx

ROOT is a folder of scenes with annotations. For each backbone and method: detections with the one
right identity of their object (IDF1) and returns that got the old identity in their first frame
(hard recovery), per scene and over all; and CPU milliseconds of the features of a frame. `remind`
has the profile that `remind calibrate` left for the backbone, or that shipped with it. Beside it:
`remind` with published thresholds, and the bank with several, a row each, since none fits all
features. How well the features tell objects apart without any tracker: `nearest_neighbor.py`.

With `--out` runs and features are kept, and what is there is not computed again.
"""

from __future__ import annotations

import argparse
import itertools
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from remind_jax.backbone.opening import open_backbone
from remind_jax.benchmark.contenders import Contender, make_contenders
from remind_jax.benchmark.records import Record
from remind_jax.benchmark.running import Setup, run_all
from remind_jax.benchmark.scenes import Scene, find_scenes, select_scenes
from remind_jax.benchmark.scoring import Scored, by_contender, read_truth, score, summarize
from remind_jax.config import load_config
from remind_jax.config.profiles import name_profile
from remind_jax.session.live import Tracker

METHODS = ("default", "remind")
BANK_MATCHES = (0.45, 0.55, 0.65)
SHOWN = ("IDF1", "HardRecovery")
TIMED = 9  # frames, the first of which is not counted


def compare(
    backbone: str,
    scenes: Sequence[Scene],
    contenders: Sequence[Contender],
    kept: Path | None = None,
) -> dict[str, list[Scored]]:
    """Runs contenders on the features of one backbone; their runs by scene.

    Args:
      backbone: By name.
      scenes: With annotations.
      contenders: With names of their own.
      kept: Folder where runs of any backbone are kept; nowhere if left out.
    """
    opened = open_backbone(backbone)
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) if kept is None else kept / name_profile(opened.name, opened.fingerprint)
        setup = Setup(out, opened, feature_cache=out / "features", is_shown=False)
        records = run_all(setup, tuple(scenes), tuple(contenders), say_record)
        truths = {scene.name: read_truth(scene) for scene in scenes}
        runs = [score(out, record, truths[record.scene]) for record in records]
    return dict(by_contender(runs))


def time_features(backbone: str, scene: Scene) -> float:
    """Median CPU milliseconds of the features of a frame, all patches."""
    live = Tracker("default", open_backbone(backbone))
    took = []
    for frame in itertools.islice(scene.open(), TIMED):
        image = live.prepare(frame).image
        assert image is not None
        start = time.process_time()
        np.asarray(live.backbone.extract(image[None])[0])
        took.append(1e3 * (time.process_time() - start))
    return float(np.median(took[1:]))


def print_head(first: str, scenes: Sequence[Scene], last: Sequence[str] = ()) -> None:
    """The head of a Markdown table of scores by scene."""
    names = [*first.split(","), "all", *(scene.name for scene in scenes), *last]
    print("| " + " | ".join(names) + " |\n" + "| --- " * len(names) + "|", flush=True)


def print_row(names: Sequence[str], runs: Sequence[Scored], last: Sequence[str] = ()) -> None:
    """IDF1, hard recovery and identities, over all and by scene."""
    whole, _ = summarize(runs)
    cells = [_cell(whole)] + [_cell(summarize([run])[0]) for run in runs]
    print("| " + " | ".join([*names, *cells, *last]) + " |", flush=True)


def _cell(scores: dict[str, float]) -> str:
    if not scores:
        return "failed"
    shown = [f"{100 * scores[name]:.1f}" for name in SHOWN]
    return " / ".join([*shown, f"{scores['IDs']:.0f}"])


def bank(match: float) -> Contender:
    """The bank of twelve vectors with one threshold."""
    made = make_contenders(["bank"])[0]
    return Contender(
        f"bank-{match}", f"bank, {match}", made.config.updated({"thresholds.match": match})
    )


def published() -> Contender:
    """`remind` with the thresholds of the paper, whatever the features."""
    fixed = load_config({"base": "remind", "backbone_profile": False})
    return Contender("remind-published", "REMIND, published thresholds", fixed)


def say_record(record: Record, was_there: bool) -> None:
    """Tells how a run went."""
    print(f"{record.scene}, {record.contender}: {record.error or record.status}", file=sys.stderr)


def find(root: Path, names: Sequence[str]) -> tuple[Scene, ...]:
    """Annotated scenes below a folder, those named or all."""
    return tuple(scene for scene in select_scenes(find_scenes(root), names) if scene.has_masks)


def parser_of(description: str | None) -> argparse.ArgumentParser:
    """Scenes and backbones on the command line."""
    parser = argparse.ArgumentParser(
        description=description, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("root", type=Path)
    parser.add_argument("--scene", action="append", default=[], metavar="NAME")
    parser.add_argument("--backbone", action="append", required=True, metavar="NAME")
    return parser


def main() -> None:
    """Parses the command line, runs and prints Markdown."""
    parser = parser_of(__doc__)
    parser.add_argument("--methods", nargs="*", default=list(METHODS), metavar="NAME")
    parser.add_argument("--out", type=Path, metavar="FOLDER")
    given = parser.parse_args()
    scenes = find(given.root, given.scene)
    banks = (bank(match) for match in BANK_MATCHES)
    contenders = [*make_contenders(given.methods), published(), *banks]
    titles = {contender.name: contender.title for contender in contenders}
    print("IDF1 / hard recovery / identities\n")
    print_head("features,method", scenes, ["CPU ms"])
    for backbone in given.backbone:
        ms = f"{time_features(backbone, scenes[0]):.0f}"
        for name, runs in compare(backbone, scenes, contenders, given.out).items():
            print_row([backbone, titles[name]], runs, [ms])


if __name__ == "__main__":
    main()
