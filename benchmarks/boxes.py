"""What boxes alone cost, where masks are to be had: identities from masks, boxes and ellipses.

    python benchmarks/boxes.py                  the tour of `remind demo`
    python benchmarks/boxes.py SEQUENCE...      annotated sequences

Each detection of the truth is given three times: as its mask, as the box around it, and as the
ellipse in that box. Columns, in percent: detections with the one right identity of their object
(IDF1), returns that got the old identity back, detections without an identity; and identities
given, beside the objects of the truth.
"""

from __future__ import annotations

import argparse
import dataclasses
import sys
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from benchmarks.rows import show_rows
from remind_jax.frame import Frame, fill_boxes
from remind_jax.masks.run_length import encode_masks, mask_box
from remind_jax.metrics import evaluate_tracks
from remind_jax.session.live import Tracker
from remind_jax.sources import open_source
from remind_jax.synthetic import demo_options, make_scene, render


def boxes_of(masks: np.ndarray) -> np.ndarray:
    """Left, top, right and bottom of each mask, right and bottom excluded."""
    sides = np.array([mask_box(rle) for rle in encode_masks(masks)], float).reshape(-1, 4)
    return np.column_stack([sides[:, :2], sides[:, :2] + sides[:, 2:]])


def as_filled(masks: np.ndarray) -> np.ndarray:
    """Boxes in place of masks."""
    return np.asarray(fill_boxes(boxes_of(masks), masks.shape[1:]))


def as_ellipses(masks: np.ndarray) -> np.ndarray:
    """Ellipses that touch the four sides of the boxes, in place of masks."""
    planes = np.zeros(masks.shape, np.uint8)
    for plane, (left, top, right, bottom) in zip(planes, boxes_of(masks), strict=True):
        center = ((left + right - 1) / 2, (top + bottom - 1) / 2)
        cv2.ellipse(plane, (center, (right - left - 1, bottom - top - 1), 0), 1, cv2.FILLED)
    return planes.view(bool)


SHAPES: dict[str, Callable[[np.ndarray], np.ndarray]] = {
    "masks": lambda masks: masks,
    "boxes": as_filled,
    "ellipses": as_ellipses,
}


def measure(name: str, frames: Iterable[Frame], config: str) -> Iterator[dict[str, Any]]:
    """Tracks one sequence with each shape at once, so that it is read once."""
    trackers = {shape: Tracker(config) for shape in SHAPES}
    tracks: dict[str, list[Any]] = {shape: [] for shape in SHAPES}
    for frame in frames:
        if frame.detections is None:
            continue
        masks = np.asarray(frame.detections.masks)
        for shape, change in SHAPES.items():
            changed = dataclasses.replace(frame.detections, masks=change(masks))
            given = dataclasses.replace(frame, detections=changed)
            tracks[shape].append(trackers[shape].update(given))
    for shape, answered in tracks.items():
        scores = evaluate_tracks(answered).scores()
        yield {
            "name": f"{name}, {shape}",
            "IDF1": 100 * scores["IDF1"],
            "recovered": 100 * scores["Recovery"],
            "undecided": 100 * (1 - scores["FirmShare"]),
            "identities": int(scores["IDs"]),
            "objects": int(scores["GT_IDs"]),
        }


def measure_all(sequences: list[Path], config: str) -> Iterator[dict[str, Any]]:
    if not sequences:
        yield from measure("demo", render(make_scene(demo_options())), config)
    for path in sequences:
        yield from measure(path.name, open_source(path), config)


def main() -> None:
    """Parses the command line, measures and prints."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("sequences", type=Path, nargs="*")
    parser.add_argument("--config", default="default")
    parser.add_argument("--json", type=Path, help="file that the rows are written into")
    chosen = parser.parse_args()
    show_rows(measure_all(chosen.sequences, chosen.config), chosen.json)


if __name__ == "__main__":
    main()
