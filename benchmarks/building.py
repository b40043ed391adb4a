"""A building: place after place is learned, then some are visited again; time, memory, identities.

    python benchmarks/building.py [--objects 120,1200,10000] [--trackers default,bank] [--json OUT]
    python benchmarks/building.py --plot docs/figures/building.svg ROWS.json ...

Every place has twelve objects in the same grid; every object has a look of its own, nearly
orthogonal to all others; each is of one of 40 classes; features are given. A place is in view for
ten frames; the camera jumps from one to the next. Then twenty of the places are visited again. Each
size runs in a process of its own, so that peaks of memory are its own. Recalled: objects of a place
that is visited again which had a slot when its first frame was decided. A row is printed as it is
done; where one takes long, its process can be stopped and go on: CPU times tell its cost.
"""

from __future__ import annotations

import argparse
import json
import resource
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import jax
import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from benchmarks.rows import show_rows
from remind_jax.frame import Detections, Frame
from remind_jax.session.live import Tracker

PER_PLACE, STAY, BACK, CLASSES = 12, 10, 20, 40
ROWS, COLUMNS, CELL_PX, PATCH_PX = 3, 4, 96, 16
DIM = 384


class Building:
    """Frames of places; the look of every object is made anew where it is asked for."""

    def __init__(self, num_objects: int, noise: float, one_class: bool, seed: int) -> None:
        """`noise`: length of what is added to a look of length 1 in every frame."""
        self.num_places = -(-num_objects // PER_PLACE)
        self._noise, self._one_class, self._seed = noise, one_class, seed
        self._rng = np.random.default_rng(seed + 1)
        height, width = ROWS * CELL_PX, COLUMNS * CELL_PX
        self._masks = np.zeros((PER_PLACE, height, width), bool)
        self._cells = np.zeros((PER_PLACE, height // PATCH_PX, width // PATCH_PX), bool)
        for k in range(PER_PLACE):
            top, left = divmod(k, COLUMNS)
            inner = (
                slice(top * CELL_PX + 16, top * CELL_PX + 80),
                slice(left * CELL_PX + 16, left * CELL_PX + 80),
            )
            self._masks[k][inner] = True
            self._cells[k] = self._masks[k][::PATCH_PX, ::PATCH_PX]

    def visits(self) -> list[int]:
        """Places in the order in which they are in view."""
        again = self._rng.permutation(self.num_places)[:BACK]
        return [*range(self.num_places), *(int(one) for one in again)]

    def frame(self, index: int, place: int) -> Frame:
        """The place in view, with fresh noise, its objects in any order."""
        of_place = np.random.default_rng((self._seed, place))
        looks = of_place.normal(size=(PER_PLACE, DIM))
        looks /= np.linalg.norm(looks, axis=1, keepdims=True)
        classes = of_place.integers(0, CLASSES, PER_PLACE) * (not self._one_class)
        added = self._rng.normal(size=looks.shape) / np.sqrt(DIM)
        looks = looks + self._noise * added
        features = np.zeros((*self._cells.shape[1:], DIM), np.float32)
        for cells, look in zip(self._cells, looks, strict=True):
            features[cells] = look
        order = self._rng.permutation(PER_PLACE)
        detections = Detections.create(
            self._masks[order],
            [f"class {classes[k]}" for k in order],
            instance_ids=place * PER_PLACE + order,
        )
        return Frame(index, index, index / 10, str(index), None, detections, features)


def measure(
    num_objects: int, tracker_name: str, noise: float = 0.05, one_class: bool = False, seed: int = 0
) -> dict[str, Any]:
    """One row: a building of so many objects."""
    compiled: list[str] = []
    jax.monitoring.register_event_duration_secs_listener(
        lambda event, *_, **__: compiled.append(event) if "backend_compile" in event else None
    )
    building = Building(num_objects, noise, one_class, seed)
    tracker = Tracker(tracker=None if tracker_name == "default" else tracker_name)
    visits = building.visits()
    told: dict[int, int] = {}  # id of each object at the end of its first visit
    known_again = taken = asked = first_right = recalled = 0
    spent, cpu, compiled_first = [], [], 0
    for number, place in enumerate([one for one in visits for _ in range(STAY)]):
        frame = building.frame(number, place)
        start, cpu_start = time.perf_counter(), time.process_time()
        tracks = tracker.update(frame)
        spent.append(1000 * (time.perf_counter() - start))
        cpu.append(1000 * (time.process_time() - cpu_start))
        if number == 0:
            compiled_first = len(compiled)
        assert frame.detections is not None
        truth = frame.detections.instance_ids
        visit, moment = divmod(number, STAY)
        pairs = list(zip(truth.tolist(), tracks.object_id.tolist(), strict=True))
        if visit < building.num_places:
            told |= dict(pairs)
        elif moment == 0:
            first_right += sum(told[thing] == one for thing, one in pairs)
            present = set(np.asarray(tracker.state.objects.id).tolist())
            recalled += sum(told[thing] in present for thing, _ in pairs)
        elif moment == STAY - 1:
            asked += len(pairs)
            known_again += sum(told[thing] == one for thing, one in pairs)
            taken += sum(one in told.values() for thing, one in pairs if told[thing] != one)
    later = np.array(spent[1:])
    return {
        "name": f"{tracker_name}, {building.num_places * PER_PLACE} objects",
        "tracker": tracker_name,
        "objects": building.num_places * PER_PLACE,
        "median_ms": float(np.median(later)),
        "p95_ms": float(np.percentile(later, 95)),
        "most_ms": float(later.max()),
        "cpu_ms": float(np.median(cpu[1:])),
        "cpu_p95_ms": float(np.percentile(cpu[1:], 95)),
        "peak_GB": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20,
        "distinct": len(set(told.values())),
        "asked": asked,
        "known_again": known_again,
        "taken": taken,
        "first_frame": first_right,
        "recalled": recalled,
        "compiled_later": len(compiled) - compiled_first,
    }


def rows(arguments: argparse.Namespace) -> Iterator[dict[str, Any]]:
    """Each in a process of its own."""
    for name in arguments.trackers.split(","):
        for count in arguments.objects.split(","):
            words = [sys.executable, __file__, "--one", name, "--objects", count]
            words += ["--noise", str(arguments.noise), "--seed", str(arguments.seed)]
            words += ["--one-class"] * arguments.one_class
            done = subprocess.run(words, stdout=subprocess.PIPE, text=True, check=True)
            yield json.loads(done.stdout.splitlines()[-1])


def plot(rows_of_files: list[dict[str, Any]], path: Path) -> None:
    """Cost of a frame and memory of the process over the objects known, a line for each tracker."""
    import matplotlib

    matplotlib.use("Agg")
    matplotlib.rcParams.update({"svg.hashsalt": "building", "svg.fonttype": "none", "font.size": 9})
    import matplotlib.pyplot as plt

    figure, panels = plt.subplots(1, 2, figsize=(7, 2.6), layout="constrained")
    shown = {"median_ms": "median frame, ms", "peak_GB": "peak memory of the process, GB"}
    for panel, (name, title) in zip(panels, shown.items(), strict=True):
        for tracker in dict.fromkeys(row["tracker"] for row in rows_of_files):
            own = [row for row in rows_of_files if row["tracker"] == tracker]
            own.sort(key=lambda row: row["objects"])
            label = "default (plus)" if tracker == "default" else tracker
            values = [row[name] for row in own]
            panel.plot([row["objects"] for row in own], values, marker="o", ms=3, label=label)
        panel.set(xscale="log", xlabel="objects known", title=title)
        panel.set_ylim(bottom=0)
        panel.spines[["top", "right"]].set_visible(False)
    panels[0].legend(frameon=False)
    figure.savefig(path, metadata={"Date": None})


def main() -> None:
    """Measures what the command line names."""
    parser = argparse.ArgumentParser(description="A building: place after place is learned.")
    parser.add_argument("--objects", default="120,1200,10000")
    parser.add_argument("--trackers", default="default,bank")
    parser.add_argument("--noise", type=float, default=0.05)
    parser.add_argument("--one-class", action="store_true")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--one", help=argparse.SUPPRESS)
    parser.add_argument("--json", type=Path)
    parser.add_argument("--plot", type=Path)
    parser.add_argument("rows", nargs="*", type=Path)
    arguments = parser.parse_args()
    if arguments.plot:
        plot(
            [row for path in arguments.rows for row in json.loads(path.read_text())], arguments.plot
        )
    elif arguments.one:
        count, noise = int(arguments.objects), arguments.noise
        row = measure(count, arguments.one, noise, arguments.one_class, arguments.seed)
        print(json.dumps(row))
    else:
        show_rows(rows(arguments), arguments.json)


if __name__ == "__main__":
    main()
