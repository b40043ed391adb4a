"""A live loop that meets a new object every half second: how long its slowest frames take.

    python benchmarks/growth.py                 400 objects, 10 frames a second, 640x480
    python benchmarks/growth.py --objects 150 --json rows.json

A camera glides along a wall of textured things, in real time. Afterwards the same frames are given,
as fast as they go, to a tracker that has room for all from the start; identities must be equal.
Nothing is taken from an earlier process unless `--programs FOLDER` names what one left behind.
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from benchmarks.rows import show_rows

WIDTH_PX, HEIGHT_PX = 640, 480
THING_PX, PITCH_PX = 96, 160  # side of a thing, and from one to the next
ROWS = 2


def picture(position_px: int, textures: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """What the camera sees from a position: RGB image and the masks of things in view."""
    image = np.full((HEIGHT_PX, WIDTH_PX, 3), 96, np.uint8)
    masks = []
    for number, texture in enumerate(textures):
        column, row = divmod(number, ROWS)
        # Every other thing is half a step further, so that they come one at a time.
        left = WIDTH_PX + column * PITCH_PX + row * PITCH_PX // ROWS - position_px
        top = 80 + 180 * row
        if left <= -THING_PX or left >= WIDTH_PX:
            continue
        first, last = max(0, left), min(WIDTH_PX, left + THING_PX)
        image[top : top + THING_PX, first:last] = texture[:, first - left : last - left]
        mask = np.zeros((HEIGHT_PX, WIDTH_PX), bool)
        mask[top : top + THING_PX, first:last] = True
        masks.append(mask)
    return image, np.array(masks, bool).reshape(-1, HEIGHT_PX, WIDTH_PX)


def textures(num: int) -> np.ndarray:
    """Squares of random colored tiles."""
    tiles = np.random.default_rng(0).integers(0, 255, (num, 6, 6, 3), np.uint8)
    return np.kron(tiles, np.ones((1, THING_PX // 6, THING_PX // 6, 1), np.uint8))


def follow(
    config: Any, num_objects: int, fps: float, *, in_time: bool
) -> tuple[list[list[int]], np.ndarray, Any]:
    """Identities of all frames, milliseconds of each, and the tracker."""
    import remind_jax as rj

    tracker, things = rj.Tracker(config), textures(num_objects)
    speed_px = PITCH_PX / ROWS * 2 / fps  # a new thing every half second
    num_frames = int((num_objects / ROWS * PITCH_PX + WIDTH_PX) / speed_px)
    answers, spent = [], []
    began = time.perf_counter()
    for index in range(num_frames):
        image, masks = picture(round(index * speed_px), things)
        if in_time and index > 1:
            time.sleep(max(0.0, began + index / fps - time.perf_counter()))
        start = time.perf_counter()
        answers.append(tracker.update(image, masks).object_id.tolist())
        spent.append(1000 * (time.perf_counter() - start))
        if index == 0:
            began = time.perf_counter()
    return answers, np.array(spent), tracker


def measure(config: str, num_objects: int, fps: float) -> Iterator[dict[str, Any]]:
    """The loop, and the same with room from the start."""
    grown, spent, tracker = follow(config, num_objects, fps, in_time=True)
    slowest = np.sort(spent[1:])[::-1][:5]
    yield {
        "name": f"{config}, {num_objects} objects met, {fps:g} frames a second",
        "frames": len(spent),
        "identities": len({i for row in grown for i in row if i >= 0}),
        "capacity": tracker.static.num_objects,
        "first_ms": float(spent[0]),
        "median_ms": float(np.median(spent[1:])),
        "slowest_ms": [round(float(value), 1) for value in slowest],
    }
    capacity = tracker.static.num_objects
    roomy, spent, _ = follow(
        {"base": config, "static": {"num_objects": capacity}}, num_objects, fps, in_time=False
    )
    yield {
        "name": f"room for {capacity} from the start",
        "median_ms": float(np.median(spent[1:])),
        "equal": grown == roomy,
    }


def main() -> None:
    """Parses the command line, measures and prints."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--config", default="default")
    parser.add_argument("--objects", type=int, default=400)
    parser.add_argument("--fps", type=float, default=10.0)
    parser.add_argument("--programs", type=Path)
    parser.add_argument("--json", type=Path)
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        os.environ["REMIND_PROGRAMS"] = str(given.programs or folder)
        show_rows(measure(given.config, given.objects, given.fps), given.json)


if __name__ == "__main__":
    main()
