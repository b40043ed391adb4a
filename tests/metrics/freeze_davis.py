"""Writes instance maps and TrackEval's numbers for them; needs TrackEval and Pillow.

    python tests/metrics/freeze_davis.py tests/golden/metrics/davis.json

TrackEval's DAVIS cuts void pixels out of predictions only after it has measured overlaps, so that
they reach J and F but not HOTA, CLEAR and Identity. `as_is` holds its numbers unmodified, `cut`
those with overlaps measured again on the masks that it cut, and without predictions of which
nothing was left. Arrays are stored as their means.
"""

from __future__ import annotations

import json
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import trackeval  # pyright: ignore[reportMissingImports]
from hotcoco import mask as coco
from PIL import Image

NUM_FRAMES, HEIGHT, WIDTH = 5, 12, 18
VOID = 255


def draw(seed: int, *, with_void: bool) -> tuple[np.ndarray, np.ndarray]:
    """Truth and predictions `[T H W]`: walking blocks, and void along the borders of objects."""
    rng = np.random.default_rng(seed)
    truth = np.zeros((NUM_FRAMES, HEIGHT, WIDTH), np.uint8)
    answers = np.zeros_like(truth)
    for number in (1, 2, 3):
        top, left = rng.integers(0, HEIGHT - 5), rng.integers(0, WIDTH - 6)
        for frame in range(NUM_FRAMES):
            left = int(np.clip(left + rng.integers(-1, 2), 0, WIDTH - 6))
            area = np.s_[top : top + 4, left : left + 5]
            if rng.random() < 0.85:
                truth[frame][area] = number
            if rng.random() < 0.85:
                shifted = np.roll(truth[frame] == number, rng.integers(-1, 2), axis=1)
                answers[frame][shifted] = 10 + number + 3 * (rng.random() < 0.2)
        answers[rng.integers(NUM_FRAMES), -3:, -4:] = 20
    if with_void:
        truth[:, HEIGHT // 2 - 1 : HEIGHT // 2 + 1] = VOID
        truth[NUM_FRAMES // 2] = np.where(truth[NUM_FRAMES // 2] == 2, VOID, truth[NUM_FRAMES // 2])
    return truth, answers


def score(truth: np.ndarray, answers: np.ndarray) -> dict[str, Any]:
    """Overlaps of each frame and all fields."""
    with tempfile.TemporaryDirectory() as name:
        gt, tracker = Path(name) / "gt" / "scene", Path(name) / "trackers" / "t" / "data" / "scene"
        for folder, maps in ((gt, truth), (tracker, answers)):
            folder.mkdir(parents=True)
            for frame, labels in enumerate(maps):
                Image.fromarray(labels).save(folder / f"{frame:05d}.png")
        dataset = trackeval.datasets.DAVIS(
            {
                "GT_FOLDER": str(gt.parent),
                "TRACKERS_FOLDER": str(Path(name) / "trackers"),
                "PRINT_CONFIG": False,
            }
        )
        raw = dataset.get_raw_seq_data("t", "scene")
        data = dataset.get_preprocessed_seq_data(raw, "general")
    as_is = measure(data)
    ids, overlaps = [], []
    for place, masks in enumerate(data["tracker_dets"]):
        left = [row for row, mask in enumerate(masks) if coco.area(mask) > 0]
        found = dataset._calculate_similarities(data["gt_dets"][place], [masks[r] for r in left])
        ids.append(data["tracker_ids"][place][left])
        overlaps.append(np.asarray(found).reshape(len(data["gt_dets"][place]), len(left)))
    labels = np.unique(np.concatenate(ids))
    cut = {
        "tracker_ids": [np.searchsorted(labels, frame) for frame in ids],
        "similarity_scores": overlaps,
        "num_tracker_ids": len(labels),
        "num_tracker_dets": sum(map(len, ids)),
    }
    return {
        "as_is": as_is,
        "cut": measure({**data, **cut}),
        "overlaps": [matrix.tolist() for matrix in overlaps],
    }


def measure(data: dict[str, Any]) -> dict[str, float]:
    """All fields of the standard metrics."""
    quiet = {"PRINT_CONFIG": False}
    metrics = trackeval.metrics
    fields = {}
    for metric in (metrics.HOTA(), metrics.CLEAR(quiet), metrics.Identity(quiet)):
        fields |= metric.eval_sequence(data)
    return {name: float(np.mean(value)) for name, value in fields.items()}


def main() -> None:
    cases = {}
    for seed, with_void in ((1, False), (2, True), (3, True), (4, True)):
        truth, answers = draw(seed, with_void=with_void)
        cases[f"{'void' if with_void else 'plain'}_{seed}"] = {
            "truth": truth.tolist(),
            "answers": answers.tolist(),
            **score(truth, answers),
        }
    Path(sys.argv[1]).write_text(json.dumps(cases, separators=(",", ":")) + "\n")


if __name__ == "__main__":
    main()
