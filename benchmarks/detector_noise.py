"""Exact masks made as bad as a detector's: jittered, missing, split, merged, false, misnamed."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Iterator, Sequence

import cv2
import numpy as np
from jaxtyping import Bool

from remind_jax.errors import ConfigError
from remind_jax.frame import NO_INSTANCE, Detections, Frame


@dataclasses.dataclass(frozen=True)
class DetectorNoise:
    """Rates are probabilities per detection (or per frame, for `false`)."""

    seed: int = 0
    jitter_px: float = 0.0  # spread of border growth and of shifts
    missing: float = 0.0
    split: float = 0.0  # one object as two detections, both with its instance id
    merged: float = 0.0  # with its nearest neighbor, under the id and label of the larger
    false: float = 0.0  # one more detection of nothing, instance id -1
    wrong_class: float = 0.0
    every: int = 1  # masks only in every n-th frame; the others have no detections

    def __post_init__(self) -> None:
        for name in ("missing", "split", "merged", "false", "wrong_class"):
            rate = getattr(self, name)
            if not 0 <= rate <= 1:
                raise ConfigError(f"detector noise {name}={rate!r} is no probability; give 0 to 1")
        if self.jitter_px < 0 or self.every < 1:
            raise ConfigError(
                f"detector noise jitter_px={self.jitter_px!r}, every={self.every!r} is not "
                "allowed; give jitter_px of 0 or more and every of 1 or more"
            )


def add_detector_noise(
    frames: Iterable[Frame], noise: DetectorNoise, classes: Sequence[str]
) -> Iterator[Frame]:
    """The same frames with worse detections; `classes` are the names that a mistake may give.

    Each frame's mistakes depend only on the seed and on its index, not on the frames before.
    """
    for frame in frames:
        if frame.detections is None:
            yield frame
            continue
        detections = worsen(frame.detections, noise, classes, frame.index)
        yield dataclasses.replace(frame, detections=detections)


def worsen(
    detections: Detections, noise: DetectorNoise, classes: Sequence[str], frame_index: int
) -> Detections:
    """Applies all kinds of mistakes to the detections of one frame."""
    rng = np.random.default_rng([noise.seed, 20, frame_index])
    height, width = detections.masks.shape[1:]
    if frame_index % noise.every:
        return Detections.empty(height, width)
    items = [
        (mask, label, int(instance))
        for mask, label, instance in zip(
            detections.masks, detections.labels, detections.instance_ids, strict=True
        )
        if rng.random() >= noise.missing
    ]
    items = _merge(items, noise.merged, rng)
    made: list[tuple[np.ndarray, str, int]] = []
    for mask, label, instance in items:
        if rng.random() < noise.wrong_class:
            others = [name for name in classes if name != label]
            label = others[int(rng.integers(len(others)))] if others else label
        pieces = _split(mask, rng) if rng.random() < noise.split else [mask]
        made += [(_jitter(piece, noise.jitter_px, rng), label, instance) for piece in pieces]
    if rng.random() < noise.false:
        label = classes[int(rng.integers(len(classes)))] if classes else "object"
        made.append((_draw_blob(height, width, rng), label, NO_INSTANCE))
    made = [item for item in made if item[0].any()]
    if not made:
        return Detections.empty(height, width)
    masks, labels, instances = zip(*made, strict=True)
    scores = rng.uniform(0.5, 1.0, len(made))
    return Detections.create(np.stack(masks), labels, scores, np.array(instances))


def _merge(
    items: list[tuple[np.ndarray, str, int]], rate: float, rng: np.random.Generator
) -> list[tuple[np.ndarray, str, int]]:
    left = list(items)
    done = []
    while left:
        mask, label, instance = left.pop(0)
        if left and rng.random() < rate:
            center = np.argwhere(mask).mean(0)
            gaps = [np.linalg.norm(np.argwhere(other[0]).mean(0) - center) for other in left]
            other_mask, other_label, other_instance = left.pop(int(np.argmin(gaps)))
            if other_mask.sum() > mask.sum():
                label, instance = other_label, other_instance
            mask = mask | other_mask
        done.append((mask, label, instance))
    return done


def _split(mask: Bool[np.ndarray, "H W"], rng: np.random.Generator) -> list[np.ndarray]:
    """Two pieces on both sides of a line through the middle."""
    points = np.argwhere(mask)
    angle = rng.uniform(0, np.pi)
    side = (points - points.mean(0)) @ np.array([np.sin(angle), np.cos(angle)]) > 0
    pieces = []
    for keep in (side, ~side):
        piece = np.zeros_like(mask)
        piece[tuple(points[keep].T)] = True
        pieces.append(piece)
    return pieces


def _jitter(
    mask: Bool[np.ndarray, "H W"], jitter_px: float, rng: np.random.Generator
) -> Bool[np.ndarray, "H W"]:
    """Grows or shrinks the border and shifts the whole."""
    if jitter_px == 0:
        return mask
    grow = round(float(rng.normal(0, jitter_px)))
    size = 2 * abs(grow) + 1
    kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (size, size))
    change = cv2.dilate if grow > 0 else cv2.erode
    changed = change(mask.astype(np.uint8), kernel)
    x, y = rng.normal(0, jitter_px / 2, 2)
    shift = np.array([[1, 0, round(float(x))], [0, 1, round(float(y))]], np.float32)
    moved = cv2.warpAffine(changed, shift, mask.shape[::-1], flags=cv2.INTER_NEAREST)
    return moved.astype(bool)


def _draw_blob(height: int, width: int, rng: np.random.Generator) -> Bool[np.ndarray, "H W"]:
    blob = np.zeros((height, width), np.uint8)
    center = (int(rng.integers(width)), int(rng.integers(height)))
    axes = (int(rng.integers(8, 8 + width // 10)), int(rng.integers(8, 8 + height // 10)))
    cv2.ellipse(blob, center, axes, float(rng.uniform(0, 180)), 0, 360, 1, -1)
    return blob.astype(bool)
