"""Time of an evaluation, beside TrackEval in the same run, alternating.

    python benchmarks/metrics.py [--json OUT] [--peer-python PYTHON]

A made-up sequence (1,000 frames, 40 objects with misses, gaps and switches) is written as
MOTChallenge text. Rows: from the two files to the scores, and each metric from loaded data. The
peer is looked for in the environment of `--peer-python` (or of the variable TRACKEVAL_PYTHON),
where `pip install trackeval` has put it.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from remind_jax.metrics.clear import clear_scores, count_clear
from remind_jax.metrics.evaluation import evaluate_sequence
from remind_jax.metrics.hota import count_hota, hota_scores
from remind_jax.metrics.identity import count_identity, identity_scores
from remind_jax.metrics.text_sequences import load_mot_sequence

NUM_FRAMES, NUM_OBJECTS = 1000, 40
FRAME_SIZE_PX = np.array([1800.0, 900.0])
METRICS = {"HOTA": count_hota, "CLEAR": count_clear, "Identity": count_identity}
SCORES = {"HOTA": hota_scores, "CLEAR": clear_scores, "Identity": identity_scores}
FILES, ALL_METRICS = "files to scores", "HOTA + CLEAR + Identity"

# Sums of some ten thousand numbers in another order.
AGREEMENT = 1e-9


def write_sequence(folder: Path, seed: int = 0) -> None:
    """Walking boxes that bounce at the border, vanish at times, and are tracked with errors."""
    rng = np.random.default_rng(seed)
    position = rng.uniform(0, FRAME_SIZE_PX, (NUM_OBJECTS, 2))
    velocity = rng.normal(0, 4, (NUM_OBJECTS, 2))
    size = rng.uniform([40, 80], [100, 220], (NUM_OBJECTS, 2))
    label, next_label = np.arange(NUM_OBJECTS), NUM_OBJECTS
    gt, pred = [], []
    for frame in range(NUM_FRAMES):
        position += velocity
        velocity[(position < 0) | (position > FRAME_SIZE_PX)] *= -1
        visible = np.sin(frame / 60 + 1.7 * np.arange(NUM_OBJECTS)) > -0.75
        for i in np.flatnonzero(visible):
            box = np.concatenate([position[i], size[i]])
            gt.append(f"{frame + 1},{i + 1}," + ",".join(f"{v:.2f}" for v in box) + ",1,1,1")
            if rng.random() < 0.003:
                label[i], next_label = next_label, next_label + 1
            if rng.random() < 0.95:
                seen = ",".join(f"{v:.2f}" for v in box + rng.normal(0, 4, 4))
                pred.append(f"{frame + 1},{label[i] + 1},{seen},0.9,-1,-1,-1")
    (folder / "gt.txt").write_text("\n".join(gt) + "\n")
    (folder / "pred.txt").write_text("\n".join(pred) + "\n")


class Peer:
    """TrackEval in its own process; absent if its environment has none."""

    def __init__(self, python: str, folder: Path):
        worker = Path(__file__).with_name("trackeval_peer.py")
        self.process = subprocess.Popen(
            [python, str(worker), str(folder), str(NUM_FRAMES)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            text=True,
        )

    def evaluate(self) -> dict[str, Any] | None:
        """Times and scores of one evaluation; nothing if there is no peer."""
        assert self.process.stdin is not None
        assert self.process.stdout is not None
        try:
            self.process.stdin.write("run\n")
            self.process.stdin.flush()
        except BrokenPipeError:
            return None
        line = self.process.stdout.readline()
        return json.loads(line) if line else None

    def close(self) -> None:
        """Ends the process."""
        self.process.kill()
        self.process.wait()


def time_ms(run: Callable[[], Any]) -> float:
    start = time.perf_counter()
    run()
    return 1e3 * (time.perf_counter() - start)


def score_files(gt_path: Path, pred_path: Path) -> list[dict[str, Any]]:
    """What the peer computes, no more: `evaluate_files` adds recovery to this."""
    sequence = load_mot_sequence(gt_path, pred_path)
    return [SCORES[name](count(sequence)) for name, count in METRICS.items()]


def measure_ours(folder: Path) -> dict[str, float]:
    """Milliseconds of each row; metrics start from data without anything derived from it."""
    paths = folder / "gt.txt", folder / "pred.txt"
    rows = {FILES: time_ms(lambda: score_files(*paths))}
    sequence = load_mot_sequence(*paths)
    fresh = dataclasses.replace(sequence)
    rows[ALL_METRICS] = time_ms(lambda: [count(fresh) for count in METRICS.values()])
    for name, count in METRICS.items():
        fresh = dataclasses.replace(sequence)
        rows[name] = time_ms(lambda count=count, fresh=fresh: count(fresh))
    return rows


def peer_rows(ms: dict[str, float]) -> dict[str, float]:
    metrics = {name: ms[name] for name in METRICS}
    return {FILES: sum(ms.values()), ALL_METRICS: sum(metrics.values()), **metrics}


def check_agreement(folder: Path, theirs: dict[str, float]) -> float:
    """Largest difference of any score; stops if it is more than rounding."""
    ours = evaluate_sequence(load_mot_sequence(folder / "gt.txt", folder / "pred.txt")).scores()
    difference = max(abs(ours[name] - value) for name, value in theirs.items())
    if difference > AGREEMENT:
        raise SystemExit(f"scores differ from TrackEval's by {difference:.3g}")
    return difference


def measure(peer_python: str, repeats: int) -> list[dict[str, Any]]:
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        write_sequence(folder)
        peer = Peer(peer_python, folder)
        ours, theirs = [], []
        answer = peer.evaluate()
        if answer is not None:
            print(
                f"largest difference of any score: {check_agreement(folder, answer['scores']):.1e}"
            )
        measure_ours(folder)
        for _ in range(repeats):
            ours.append(measure_ours(folder))
            if (answer := peer.evaluate()) is not None:
                theirs.append(peer_rows(answer["ms"]))
        peer.close()
    rows = []
    for row in ours[0]:
        ours_ms = statistics.median(times[row] for times in ours)
        peer_ms = statistics.median(times[row] for times in theirs) if theirs else None
        rows.append(
            {
                "name": f"metrics: {row}",
                "ours_ms": round(ours_ms, 2),
                "peer": "TrackEval" if theirs else "TrackEval (absent)",
                "peer_ms": round(peer_ms, 2) if peer_ms else None,
                "ratio": round(peer_ms / ours_ms, 2) if peer_ms else None,
            }
        )
    return rows


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--json", type=Path, help="write the rows here")
    parser.add_argument("--repeats", type=int, default=7)
    parser.add_argument(
        "--peer-python",
        default=os.environ.get("TRACKEVAL_PYTHON", sys.executable),
        help="interpreter of an environment with TrackEval",
    )
    arguments = parser.parse_args()
    rows = measure(arguments.peer_python, arguments.repeats)
    for row in rows:
        print(json.dumps(row))
    if arguments.json:
        arguments.json.write_text(json.dumps(rows, indent=1))


if __name__ == "__main__":
    main()
