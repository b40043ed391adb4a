"""What each part of the shipped profile of the default features contributes.

    python benchmarks/profile_parts.py [--tours 4] [--frames 150]

Rendered tours of development seeds (from 41 on), as hard as those of the benchmark, on which the
profile was chosen: look-alikes, absence, light and crowds in turn. Rows: the published thresholds
within `remind`, the profile, the profile with one part as published, and without context. Prints
Markdown: mean IDF1, then IDF1, hard recovery and identities of each tour.
"""

from __future__ import annotations

import argparse
import dataclasses
import sys
import tempfile
from collections.abc import Mapping
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from remind_jax.backbone.registry import DEFAULT_BACKBONE
from remind_jax.benchmark.tours import benchmark_tours, render_tours
from remind_jax.config import load_config
from remind_jax.config.dotted_keys import flatten_fields
from remind_jax.sweeps.bench import SceneBench
from remind_jax.sweeps.settings import Setting

FIRST_SEED = 41
TOURS = ("alike-2", "absent-1", "light-2", "dense-2", "alike-3", "light-1")
PARTS = {
    "match and weights": ("matching.", "similarity."),
    "context": ("influence.",),
    "doubt between known objects": ("ambiguous.",),
    "doubt about new ones": ("provisional.",),
    "quality of small views": ("appearance.",),
}


def render(count: int, frames: int, folder: Path) -> list[Path]:
    """Tours like those of the benchmark with seeds and lengths of development."""
    known = {tour.name: tour for tour in benchmark_tours()}
    tours = tuple(
        dataclasses.replace(known[name], seed=FIRST_SEED + place, frames=frames)
        for place, name in enumerate(TOURS[:count])
    )
    root = render_tours(folder, tours)
    return [root / tour.name for tour in tours]


def settings() -> dict[str, Setting]:
    """Settings by the name of their row."""
    fixed = load_config({"base": "remind", "backbone_profile": False})
    published = dict(flatten_fields(fixed.thresholds))
    shipped = dict(flatten_fields(load_config("remind").for_backbone(DEFAULT_BACKBONE).thresholds))
    changed = {name: value for name, value in shipped.items() if value != published[name]}
    back = {name: published[name] for name in changed}
    rows = {"published": back, "profile": changed}
    for part, starts in PARTS.items():
        rows[f"{part} as published"] = changed | _below(back, starts)
    rows["without context"] = changed | {"influence.enabled": False}
    return rows


def _below(setting: Mapping[str, float], starts: tuple[str, ...]) -> Setting:
    return {name: value for name, value in setting.items() if name.startswith(starts)}


def main() -> None:
    """Parses the command line, renders, runs and prints."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--tours", type=int, default=4, choices=range(1, len(TOURS) + 1))
    parser.add_argument("--frames", type=int, default=150)
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        scenes = render(given.tours, given.frames, Path(folder))
        tried = settings()
        found = SceneBench(scenes, config="remind").run(list(tried.values()))
    names = ["thresholds", "mean IDF1", *(scene.name for scene in scenes)]
    print("| " + " | ".join(names) + " |\n" + "| --- " * len(names) + "|")
    for name, standing, rows in zip(tried, found.standings(), found.rows, strict=True):
        cells = [
            f"{100 * row.scores['IDF1']:.1f} / {100 * row.scores['HardRecovery']:.1f} / "
            f"{row.scores['Identities']:.0f}"
            for row in rows
        ]
        print(f"| {name} | {100 * standing.scores['IDF1']:.1f} | " + " | ".join(cells) + " |")


if __name__ == "__main__":
    main()
