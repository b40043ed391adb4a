"""Draws how often answers of REMIND plus are right, against the confidence that it reports.

    python docs/plus_reliability.py docs/figures/plus_reliability.png SEQUENCE...

Left: the given sequences; right: six tours like those of the benchmark, of development seeds. Both
with classes and, all but four of the tours, as one class. Prints the expected calibration errors.
"""

from __future__ import annotations

import dataclasses
import sys
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from benchmarks.plus import reliability
from benchmarks.plus_recording import Recording, record
from remind_jax.benchmark.tours import benchmark_tours
from remind_jax.frame import Frame
from remind_jax.sources import open_source
from remind_jax.synthetic import SceneOptions, make_scene, render

TOURS = ("alike-3", "absent-3", "light-3", "dense-3", "absent-2", "dense-2")
AS_ONE_CLASS = ("alike-3", "absent-2")
FIRST_SEED = 50


def development_tours() -> dict[str, SceneOptions]:
    """Tours that the benchmark never shows."""
    tours = {tour.name: tour for tour in benchmark_tours()}
    return {
        name: dataclasses.replace(tours[name], seed=FIRST_SEED + number)
        for number, name in enumerate(TOURS)
    }


def record_each(scenes: Mapping[str, Iterable[Frame]], one_class: bool) -> list[Recording]:
    """All scenes with the default features."""
    return [record(name, scene, "patch-statistics", one_class) for name, scene in scenes.items()]


def draw(axis: Any, title: str, kinds: dict[str, list[Recording]]) -> None:
    """One line per kind; the size of a point is the share of detections."""
    axis.plot([0.2, 1], [0.2, 1], ":k", lw=1)
    for kind, recordings in kinds.items():
        *bins, total = reliability(recordings)
        error = total["confidence"] / 100
        confidence, right = ([row[key] / 100 for row in bins] for key in ("confidence", "right"))
        count = [row["detections"] for row in bins]
        (line,) = axis.plot(confidence, right, lw=1)
        sizes = [15 + 180 * one / sum(count) for one in count]
        label = f"{kind}: ECE {error:.3f}"
        axis.scatter(confidence, right, s=sizes, color=line.get_color(), label=label)
        print(f"{title}, {label}")
    axis.set(title=title, xlabel="confidence", ylabel="share right")
    axis.set(xlim=(0.2, 1.02), ylim=(0, 1.02))
    axis.legend(loc="lower right")


def main() -> None:
    """Writes the picture."""
    out, *paths = sys.argv[1:]
    sequences = {Path(path).name: open_source(path) for path in paths}
    tours = {name: list(render(make_scene(o))) for name, o in development_tours().items()}
    few = {name: tours[name] for name in AS_ONE_CLASS}
    figure, (left, right) = plt.subplots(1, 2, figsize=(8, 3.8), dpi=100)
    both = {"classes": (sequences, tours), "one class": (sequences, few)}
    for axis, title, place in ((left, ", ".join(sequences), 0), (right, "generated tours", 1)):
        kinds = {kind: record_each(of[place], kind == "one class") for kind, of in both.items()}
        draw(axis, title, kinds)
    figure.tight_layout()
    figure.savefig(out)


if __name__ == "__main__":
    main()
