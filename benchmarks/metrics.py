"""Equality with TrackEval on all stored cases; then time beside TrackEval, alternating.

    python benchmarks/metrics.py [--json OUT] [--peer-python PYTHON]

Stored cases are those of `tests/golden/metrics` with the numbers that TrackEval gave for them. A
made-up sequence (1,000 frames, 40 objects with misses, gaps and switches) is written as
MOTChallenge text. Rows: from the two files to the scores, and each metric from loaded data. The
peer is looked for in the environment of `--peer-python` (or of the variable TRACKEVAL_PYTHON),
where `pip install trackeval` has put it.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import math
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from remind_jax.formats.mot import FileFormat, fit_texts, read_text_rows
from remind_jax.metrics.clear import clear_scores, split_clear
from remind_jax.metrics.combine import total_counts
from remind_jax.metrics.evaluation import evaluate_sequence, pool_evaluations
from remind_jax.metrics.hota import hota_scores, match_hota, split_hota
from remind_jax.metrics.identity import IdentityCounts, count_right, identity_scores
from remind_jax.metrics.pairing import pair_scene
from remind_jax.metrics.scene_evaluation import evaluate
from remind_jax.metrics.sequence import TrackingSequence

GOLDEN = Path(__file__).resolve().parents[1] / "tests" / "golden" / "metrics"
NUM_FRAMES, NUM_OBJECTS = 1000, 40
FRAME_SIZE_PX = np.array([1800.0, 900.0])
METRICS: dict[str, Callable[[TrackingSequence], Any]] = {
    "HOTA": lambda sequence: total_counts(*split_hota(sequence, match_hota(sequence))),
    "CLEAR": lambda sequence: total_counts(*split_clear(sequence)),
    "Identity": lambda sequence: count_identity(sequence),
}
SCORES = {"HOTA": hota_scores, "CLEAR": clear_scores, "Identity": identity_scores}
FILES, ALL_METRICS = "files to scores", "HOTA + CLEAR + Identity"

# Sums of some ten thousand numbers in another order.
AGREEMENT = 1e-9


# How far a value is from TrackEval's, and whether that is above 1: a count or a sum.
Difference = tuple[float, bool]


@dataclasses.dataclass(frozen=True)
class Agreement:
    """How far our numbers are from TrackEval's on one kind of case."""

    kind: str
    cases: int
    differences: list[Difference]

    def to_line(self) -> str:
        """A line of the table."""
        return (
            f"{self.kind:34} {self.cases:5} {len(self.differences):7} "
            f"{self.largest(sums=False):11.1e} {self.largest(sums=True):11.1e}"
        )

    def largest(self, *, sums: bool) -> float:
        """Largest difference among ratios, or among counts and sums."""
        return max((apart for apart, is_sum in self.differences if is_sum == sums), default=0.0)


def count_identity(sequence: TrackingSequence) -> IdentityCounts:
    right = int(count_right(sequence).sum())
    wrong = len(sequence.gt) - right, len(sequence.pred) - right
    return IdentityCounts(*map(np.asarray, (right, *wrong)))


def compare_stored() -> list[Agreement]:
    """All stored cases, kind by kind."""
    found = [_compare_text("boxes", "mot"), _compare_text("masks", "mots")]
    found.append(_compare_pooled())
    return [*found, _compare_davis()]


def differences(ours: dict[str, Any], theirs: dict[str, Any]) -> list[Difference]:
    """Of every field of theirs; arrays over thresholds count each."""
    found: list[Difference] = []
    for name, value in theirs.items():
        expected = np.asarray(value, float).ravel()
        apart = np.abs(np.asarray(ours[name], float).ravel() - expected)
        found += zip(apart.tolist(), (np.abs(expected) > 1).tolist(), strict=True)
    return found


def load_texts(
    gt_path: Path, pred_path: Path, format: FileFormat, num_frames: int | None = None
) -> TrackingSequence:
    """Two text files as a sequence, read as TrackEval reads them."""
    truth = read_text_rows(gt_path, "truth", format, is_truth=True)
    prediction = read_text_rows(pred_path, "prediction", format, is_truth=False)
    return pair_scene(*fit_texts(truth, prediction, num_frames=num_frames)).sequence


def _compare_text(kind: str, format: FileFormat) -> Agreement:
    found: list[Difference] = []
    folders = sorted((GOLDEN / kind).iterdir())
    for folder in folders:
        frames = json.loads((folder / "case.json").read_text())["frames"]
        expected = json.loads((folder / "expected.json").read_text())
        ties = expected["order_sensitive_fields"]
        theirs = {k: v for m in SCORES for k, v in expected[m].items() if k not in ties}
        sequence = load_texts(folder / "gt.txt", folder / "pred.txt", format, frames)
        found += differences(evaluate_sequence(sequence).fields(), theirs)
    return Agreement(kind, len(folders), found)


def _compare_pooled() -> Agreement:
    expected = json.loads((GOLDEN / "combined_masks.json").read_text())
    parts = []
    for name in expected["sequences"]:
        folder = GOLDEN / "masks" / name
        frames = json.loads((folder / "case.json").read_text())["frames"]
        sequence = load_texts(folder / "gt.txt", folder / "pred.txt", "mots", frames)
        parts.append(evaluate_sequence(sequence))
    theirs = {k: v for metric in SCORES for k, v in expected[metric].items()}
    return Agreement("masks, pooled", 1, differences(pool_evaluations(parts).fields(), theirs))


def _compare_davis() -> Agreement:
    cases = json.loads((GOLDEN / "davis.json").read_text())
    found: list[Difference] = []
    for case in cases.values():
        with tempfile.TemporaryDirectory() as name:
            for side in ("truth", "answers"):
                (Path(name) / side).mkdir()
                for frame, labels in enumerate(np.asarray(case[side], np.uint8)):
                    cv2.imwrite(str(Path(name) / side / f"{frame:05d}.png"), labels)
            ours = evaluate(Path(name) / "truth", Path(name) / "answers").scores()
        found += differences(ours, case["cut"])
    return Agreement("instance maps with void (DAVIS)", len(cases), found)


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
    sequence = load_texts(gt_path, pred_path, "mot")
    return [SCORES[name](count(sequence)) for name, count in METRICS.items()]


def measure_ours(folder: Path) -> dict[str, float]:
    """Milliseconds of each row; metrics start from data without anything derived from it."""
    paths = folder / "gt.txt", folder / "pred.txt"
    rows = {FILES: time_ms(lambda: score_files(*paths))}
    sequence = load_texts(*paths, "mot")
    fresh = dataclasses.replace(sequence)
    rows[ALL_METRICS] = time_ms(lambda: [count(fresh) for count in METRICS.values()])
    for name, count in METRICS.items():
        fresh = dataclasses.replace(sequence)
        rows[name] = time_ms(lambda count=count, fresh=fresh: count(fresh))
    return rows


def peer_rows(ms: dict[str, float]) -> dict[str, float]:
    metrics = {name: ms[name] for name in METRICS}
    return {FILES: sum(ms.values()), ALL_METRICS: sum(metrics.values()), **metrics}


def check_agreement(found: list[Agreement]) -> None:
    """Prints the table; stops if anything differs by more than rounding."""
    columns = f"{'cases':>5} {'values':>7} {'ratios':>11} {'sums':>11}"
    print(f"{'largest difference from TrackEval':34} {columns}")
    for agreement in found:
        print(agreement.to_line())
    everything = [d for agreement in found for d in agreement.differences]
    total = Agreement("all", sum(a.cases for a in found), everything)
    print(total.to_line())
    worst = max(total.largest(sums=False), total.largest(sums=True))
    if not worst <= AGREEMENT:
        raise SystemExit(f"scores differ from TrackEval's by {worst:.3g}")


def measure(peer_python: str, repeats: int) -> list[dict[str, Any]]:
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        write_sequence(folder)
        peer = Peer(peer_python, folder)
        ours, theirs = [], []
        answer = peer.evaluate()
        found = compare_stored()
        if answer is not None:
            sequence = load_texts(folder / "gt.txt", folder / "pred.txt", "mot")
            live = differences(evaluate_sequence(sequence).scores(), answer["scores"])
            found.append(Agreement(f"{NUM_FRAMES} frames x {NUM_OBJECTS} objects, live", 1, live))
        check_agreement(found)
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
    print(f"\n{'time, ms':34} {'ours':>9} {'TrackEval':>10} {'ratio':>7}")
    for row in rows:
        peer, ratio = row["peer_ms"] or math.nan, row["ratio"] or math.nan
        name = row["name"].removeprefix("metrics: ")
        print(f"{name:34} {row['ours_ms']:9.1f} {peer:10.1f} {ratio:7.1f}")
    if arguments.json:
        arguments.json.write_text(json.dumps(rows, indent=1))


if __name__ == "__main__":
    main()
