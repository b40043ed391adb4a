"""Draws where REMIND plus was most wrong on generated tours that break its assumptions.

    python docs/plus_failures.py docs/figures/plus_failures.webp

For each tour: the frame with most wrong identities, beside one that shows most of the objects in
question under their usual ids. Green: right; red: wrong, with the usual id in parentheses.
"""

from __future__ import annotations

import dataclasses
import sys
from pathlib import Path

import cv2
import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from benchmarks.detector_noise import add_detector_noise
from benchmarks.plus import STRESS, TOUR
from benchmarks.plus_recording import answer, best_ids, record
from remind_jax.frame import Frame
from remind_jax.plus.thresholds import PlusThresholds
from remind_jax.synthetic import make_scene, render
from remind_jax.synthetic.shapes import CLASSES

TOURS = ("moved 30 %", "swapped 30 %", "split, merged, false")
GREEN, RED, WHITE = (80, 200, 80), (230, 60, 50), (255, 255, 255)


def draw(frame: Frame, truth: np.ndarray, ids: np.ndarray, reference: dict[int, int]) -> np.ndarray:
    """The frame with outlines and the ids that were given."""
    assert frame.image is not None
    assert frame.detections is not None
    picture = frame.image.copy()
    for mask, thing, given in zip(frame.detections.masks, truth, ids, strict=False):
        right = reference.get(int(thing)) == given
        outline, _ = cv2.findContours(mask.astype(np.uint8), cv2.RETR_EXTERNAL, 1)
        cv2.drawContours(picture, outline, -1, GREEN if right else RED, 1)
        rows, columns = np.nonzero(mask)
        text = str(given) if right else f"{given} ({reference.get(int(thing), 'none')})"
        place = int(columns.min()), int(max(rows.min() - 3, 9))
        for color, width in (((0, 0, 0), 3), (WHITE if right else (255, 170, 160), 1)):
            cv2.putText(picture, text, place, cv2.FONT_HERSHEY_SIMPLEX, 0.4, color, width, 16)
    return picture


def worst_frames(name: str) -> np.ndarray:
    """The frame of a tour where most went wrong, and one where the same objects are right."""
    options, noise = STRESS[name]
    frames = list(render(make_scene(dataclasses.replace(TOUR, **options))))
    shown = list(add_detector_noise(frames, noise, tuple(CLASSES))) if noise else frames
    recording = record(name, shown, "patch-statistics", one_class=False)
    ids, _ = answer(recording, PlusThresholds())
    reference = best_ids(recording.truth, ids)
    wrong = np.array(
        [
            [t >= 0 and reference.get(int(t)) != i for t, i in zip(*pair, strict=True)]
            for pair in zip(recording.truth, ids, strict=True)
        ]
    )
    worst = int(wrong.sum(axis=1).argmax())
    concerned = recording.truth[worst][wrong[worst]]
    right = np.isin(recording.truth, concerned) & ~wrong
    other = len(right) - 1 - int(right.sum(axis=1)[::-1].argmax())
    pictures = []
    for index in sorted((worst, other)):
        picture = draw(shown[index], recording.truth[index], ids[index], reference)
        strip = np.full((18, picture.shape[1], 3), 30, np.uint8)
        text = f"{name}: frame {index}" + ", most are wrong" * (index == worst)
        cv2.putText(strip, text, (5, 13), cv2.FONT_HERSHEY_SIMPLEX, 0.42, WHITE, 1, 16)
        pictures.append(np.concatenate([strip, picture]))
    return np.concatenate(pictures, axis=1)


def main() -> None:
    """Writes the picture."""
    picture = np.concatenate([worst_frames(name) for name in TOURS])
    out = Path(sys.argv[1] if len(sys.argv) > 1 else "docs/figures/plus_failures.webp")
    cv2.imwrite(str(out), picture[..., ::-1], [cv2.IMWRITE_WEBP_QUALITY, 80])


if __name__ == "__main__":
    main()
