"""What calibrated thresholds are worth: the paper's tracker on the features of some backbones.

    python benchmarks/calibration.py ROOT --backbone onnx:encoder.onnx [--on SCENES ...]

ROOT is a folder of scenes with annotations. For each backbone: the published thresholds within
`remind`, those chosen by hand for the default features, and those of `remind calibrate` on other
scenes, whose identities it does not see: rendered tours of development seeds 1 to 4 if `--on` is
left out. IDF1, returns that got the old identity in their first frame, and identities given.
"""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from benchmarks.features import compare, find, parser_of, print_head, print_row, published
from remind_jax.backbone.registry import DEFAULT_BACKBONE
from remind_jax.benchmark.contenders import Contender
from remind_jax.calibration import calibrate
from remind_jax.config import Config, load_config
from remind_jax.config.dotted_keys import flatten_fields, nest
from remind_jax.synthetic import demo_options, make_scene, write_davis

SEEDS = range(1, 5)


def contenders(backbone: str, scenes: Sequence[Path], folder: Path) -> Iterator[Contender]:
    """The three sets of thresholds, each for any features."""
    fixed = published().config
    by_hand = load_config("remind").for_backbone(DEFAULT_BACKBONE)
    yield published()
    yield Contender("hand", "chosen for patch statistics", _with(fixed, by_hand))
    found = calibrate(list(scenes), backbone=backbone, out=folder / "profile.yaml")
    yield Contender("calibrated", "calibrated", _with(fixed, found.to_config()))


def _with(config: Config, other: Config) -> Config:
    """A configuration with the thresholds of another."""
    return config.updated({"thresholds": nest(dict(flatten_fields(other.thresholds)))})


def main() -> None:
    """Parses the command line, runs and prints Markdown."""
    parser = parser_of(__doc__)
    parser.add_argument("--on", type=Path, nargs="+", default=[], metavar="SCENES")
    given = parser.parse_args()
    scenes = find(given.root, given.scene)
    print("IDF1 / hard recovery / identities\n")
    print_head("features,thresholds", scenes)
    with tempfile.TemporaryDirectory() as folder:
        tours = given.on or [
            write_davis(make_scene(demo_options(seed)), Path(folder) / f"tour-{seed}")
            for seed in SEEDS
        ]
        for backbone in given.backbone:
            tried = list(contenders(backbone, tours, Path(folder)))
            titles = {one.name: one.title for one in tried}
            for name, runs in compare(backbone, scenes, tried).items():
                print_row([backbone, titles[name]], runs)


if __name__ == "__main__":
    main()
