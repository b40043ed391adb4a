"""How far tuning goes: weights of the channels chosen on generated tours, judged on other scenes.

    python benchmarks/tuning.py SEQUENCE ... [--trials 24] [--tours 2]

A grid of weights and match thresholds (the landscape), a search without gradients (TPE), gradients
of the soft assignment, and the search once more on whitened features; all on rendered tours of
seeds from 1 on. What they chose is then run on the given sequences, which nothing was chosen
on, beside the published thresholds and the profile of the backbone. Prints Markdown.
"""

from __future__ import annotations

import argparse
import dataclasses
import itertools
import time
from collections.abc import Sequence

import numpy as np

import remind_jax as rj
from benchmarks.gradients import collect_candidates, fit_weights, join_candidates
from remind_jax.backbone.registry import get_backbone
from remind_jax.frame import Frame
from remind_jax.session.live import Tracker
from remind_jax.sources import open_source
from remind_jax.sweeps.bench import SceneBench
from remind_jax.sweeps.result import SweepResult
from remind_jax.sweeps.search import search
from remind_jax.sweeps.settings import Setting
from remind_jax.synthetic import demo_options, make_scene, render

BACKBONE = "patch-statistics"
WEIGHTS = ("object_weight", "background_weight", "parts_weight")
SPACE: dict[str, tuple[float, float]] = {
    "similarity.object_weight": (0.2, 1.0),
    "similarity.background_weight": (0.1, 1.0),
    "similarity.parts_weight": (0.0, 1.0),
    "matching.match": (0.55, 0.80),
}
PROFILE = ("patches_min", "patches_full", "create_quality")  # what it changes beside these
STEPS, MATCHES = 4, (0.6, 0.7, 0.8)
CAPACITIES = {"num_detections": 20, "num_objects": 128, "num_pending": 64}
SHOWN = ("IDF1", "AssA", "Recovery", "Ambiguous", "Identities")


class Whitening:
    """Directions of features that vary much count less: principal axes of the tours' patches."""

    def __init__(self, patches: np.ndarray, ridge: float = 0.1):
        self.mean = patches.mean(axis=0)
        variance, self.axes = np.linalg.eigh(np.cov(patches - self.mean, rowvar=False))
        self.scale = 1 / np.sqrt(np.maximum(variance, 0) + ridge * variance.mean())

    def __call__(self, patches: np.ndarray) -> np.ndarray:
        """Features along the principal axes, each with about the same variance."""
        return ((patches - self.mean) @ self.axes * self.scale).astype(np.float32)


def extract(frames: list[Frame]) -> list[Frame]:
    """The frames with their features."""
    live = Tracker("default", get_backbone(BACKBONE))
    described = []
    for frame in frames:
        image = live.prepare(frame).image
        assert image is not None
        patches = np.asarray(live.backbone.extract(image[None])[0])
        described.append(dataclasses.replace(frame, features=patches))
    return described


def whiten(scenes: list[list[Frame]], whitening: Whitening) -> list[list[Frame]]:
    return [
        [dataclasses.replace(frame, features=whitening(frame.features)) for frame in scene]
        for scene in scenes
    ]


def landscape() -> list[Setting]:
    """Every split of the weights in quarters with some object and background, at some thresholds.

    Without either, nearly every view is a new object.
    """
    quarters = itertools.product(range(STEPS + 1), repeat=len(WEIGHTS))
    splits = [
        np.array(split) / STEPS for split in quarters if sum(split) == STEPS and min(split[:2])
    ]
    return [
        {
            **{f"similarity.{name}": float(w) for name, w in zip(WEIGHTS, split, strict=True)},
            "matching.match": match,
        }
        for split in splits
        for match in MATCHES
    ]


def as_setting(config: str) -> Setting:
    """The values of a configuration at what is tuned, and at all that a profile changes."""
    of = rj.load_config(config)
    if config == "remind":
        of = of.for_backbone(BACKBONE)
    names = (*SPACE, *(f"appearance.{name}" for name in PROFILE))
    return {
        name: getattr(getattr(of.thresholds, name.split(".")[0]), name.split(".")[1])
        for name in names
    }


def bench_of(scenes: list[list[Frame]]) -> SceneBench:
    config = rj.load_config({"base": "remind", "static": CAPACITIES}).for_backbone(BACKBONE)
    return SceneBench(scenes, config=config)


def descend(scenes: list[list[Frame]]) -> Setting:
    """Weights by gradients, from the candidates of traced runs."""
    config = rj.load_config({"base": "remind", "static": CAPACITIES}).for_backbone(BACKBONE)
    runs = [rj.run(scene, config=config, trace=True) for scene in scenes]
    collected = join_candidates(collect_candidates(run, config.thresholds) for run in runs)
    return fit_weights(collected, config.thresholds).setting


def tell(title: str, names: Sequence[str], result: SweepResult, scenes: Sequence[str]) -> None:
    """A table: mean scores, and the IDF1 of each scene."""
    print(f"\n{title}\n")
    head = (*SHOWN, *(f"IDF1 {scene}" for scene in scenes), "weights, match")
    print("| | " + " | ".join(head) + " |")
    print("| --- " * (2 + len(SHOWN) + len(scenes)) + "|")
    for name, standing, rows in zip(names, result.standings(), result.rows, strict=True):
        mean = [
            f"{standing.scores[m]:.0f}" if m == "Identities" else f"{100 * standing.scores[m]:.1f}"
            for m in SHOWN
        ]
        each = [f"{100 * row.scores['IDF1']:.1f}" for row in rows]
        chosen = " ".join(f"{standing.setting.get(key, float('nan')):.2f}" for key in SPACE)
        print(f"| {name} | " + " | ".join((*mean, *each, chosen)) + " |", flush=True)


def show_landscape(result: SweepResult) -> None:
    """IDF1 of every split of the weights, the best match threshold of the grid each."""
    best: dict[tuple[float, ...], tuple[float, float]] = {}
    for standing in result.standings():
        split = tuple(float(standing.setting[f"similarity.{name}"]) for name in WEIGHTS)
        found = (100 * standing.scores["IDF1"], float(standing.setting["matching.match"]))
        best[split] = max(best.get(split, found), found)
    print("\n| object | background | parts | IDF1 | at match |\n| --- | --- | --- | --- | --- |")
    for split, (score, match) in sorted(best.items(), key=lambda item: -item[1][0]):
        print("| " + " | ".join(f"{w:.2f}" for w in split) + f" | {score:.1f} | {match} |")


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("sequences", nargs="+", metavar="SEQUENCE")
    parser.add_argument("--trials", type=int, default=24)
    parser.add_argument("--tours", type=int, default=2)
    options = parser.parse_args()
    start = time.perf_counter()
    tours = [
        extract(list(render(make_scene(demo_options(seed)))))
        for seed in range(1, options.tours + 1)
    ]
    bench = bench_of(tours)
    grid = bench.run(landscape())
    show_landscape(grid)
    searched = search(bench, SPACE, number=options.trials, at_once=16)
    fixed = {k: v for k, v in as_setting("remind").items() if k not in SPACE}
    chosen: dict[str, Setting] = {
        "published": as_setting("published"),
        "profile (`remind`)": as_setting("remind"),
        "best of the grid": fixed | dict(grid.best()[0].setting),
        "search (TPE)": fixed | dict(searched.best()[0].setting),
        "gradients": fixed | descend(tours),
    }
    tour_names = [f"tour {seed}" for seed in range(1, options.tours + 1)]
    on_tours = bench.run(list(chosen.values()))
    tell("On the tours that they were chosen on", list(chosen), on_tours, tour_names)

    patches = [np.asarray(frame.features) for tour in tours for frame in tour]
    whitening = Whitening(np.concatenate([p.reshape(-1, p.shape[-1]) for p in patches]))
    white_bench = bench_of(whiten(tours, whitening))
    white = fixed | dict(
        search(white_bench, SPACE, number=options.trials, at_once=16).best()[0].setting
    )
    names = [sequence.rstrip("/").rpartition("/")[2] for sequence in options.sequences]
    others = [extract(list(open_source(sequence))) for sequence in options.sequences]
    judged = bench_of(others).run(list(chosen.values()))
    tell("On sequences that nothing was chosen on", list(chosen), judged, names)
    judged = bench_of(whiten(others, whitening)).run([as_setting("remind"), white])
    tell("The same with whitened features", ["profile", "search"], judged, names)
    print(f"\n{time.perf_counter() - start:.0f} s")


if __name__ == "__main__":
    main()
