"""How light of another color changes the default features, told from made pictures.

    python benchmarks/light_changes.py      writes remind_jax/backbone/light_changes.npy anew

The main directions of all changes, each as long as the mean change along it. No recording is
looked at: closeups of overlapping colored ellipses with grain, each in warmer, cooler and greener
light.

Letters: `B` pictures, `K` of them in each light, `D` features of a closeup, `G` directions.
"""

from __future__ import annotations

import sys
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Float, UInt8

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from remind_jax.backbone.patch_statistics import LIGHT_CHANGES, PATCH_PX, patch_statistics
from remind_jax.masks.closeups import CLOSEUP_PATCHES

NUM_PICTURES = 512
NUM_DIRECTIONS = 32  # 96 % of the mean squared change
TINTS = ((1.06, 0.97, 0.87), (0.9, 0.99, 1.06), (1.1, 0.95, 0.75), (0.95, 1.05, 0.95))
NUM_ELLIPSES = 60
BORDER = 2  # patches beside the object


def measure_changes(num_pictures: int, seed: int) -> Float[np.ndarray, "K D"]:
    """Changes of looks, that of the background included; a row for each picture in each light."""
    rng = np.random.default_rng(seed)
    pictures = np.stack([draw_picture(rng) for _ in range(num_pictures)])
    before = _looks(pictures)
    tinted = (np.clip(pictures * np.array(tint) + 0.5, 0, 255).astype(np.uint8) for tint in TINTS)
    return np.concatenate([_looks(pictures) - before for pictures in tinted])


def main_directions(changes: Float[np.ndarray, "K D"], num: int) -> Float[np.ndarray, "G D"]:
    """The longest main directions of the changes; their outer products sum to the mean."""
    _, length, direction = np.linalg.svd(changes / np.sqrt(len(changes)), full_matrices=False)
    return length[:num, None] * direction[:num]


def draw_picture(rng: np.random.Generator) -> UInt8[np.ndarray, "S S 3"]:
    """Ellipses, most of them of little color, over each other, with grain."""
    side = CLOSEUP_PATCHES * PATCH_PX
    picture = np.zeros((side, side, 3), np.float32)
    for _ in range(NUM_ELLIPSES):
        gray = np.exp(rng.uniform(np.log(20), np.log(230)))
        strength = rng.choice([0.05, 0.15, 0.4], p=[0.4, 0.35, 0.25])
        red, yellow = strength * rng.normal(size=2)
        color = gray * np.exp([red + yellow / 2, yellow / 2 - red, -yellow])
        center, axes = rng.integers(0, side, 2).tolist(), rng.integers(6, 50, 2).tolist()
        cv2.ellipse(picture, center, axes, rng.uniform(0, 180), 0, 360, color.tolist(), -1)
    grain = cv2.GaussianBlur(rng.normal(size=(side, side)), (0, 0), 1.0)[..., None]
    noise = rng.normal(0, 3, picture.shape)
    return np.clip(picture * (1 + 0.3 * grain) + noise, 0, 255).astype(np.uint8)


def _looks(pictures: UInt8[np.ndarray, "B S S 3"]) -> Float[np.ndarray, "B D"]:
    """As the tracker pools them, of an object in the middle."""
    backbone = patch_statistics()
    coverage = np.zeros((len(pictures), CLOSEUP_PATCHES, CLOSEUP_PATCHES), np.float32)
    coverage[:, BORDER:-BORDER, BORDER:-BORDER] = 1.0
    wanted = np.ones(coverage.shape, bool)
    features = np.asarray(backbone.extract_closeups(pictures, wanted, coverage))
    features = features / np.linalg.norm(features, axis=-1, keepdims=True)
    inside = coverage[0] > 0
    of_object, around = features[:, inside].mean(axis=1), features[:, ~inside].mean(axis=1)
    is_background = np.arange(features.shape[-1]) >= features.shape[-1] - backbone.num_background
    return np.where(is_background, around, of_object)


if __name__ == "__main__":
    found = main_directions(measure_changes(NUM_PICTURES, seed=0), NUM_DIRECTIONS)
    np.save(LIGHT_CHANGES, found.astype(np.float16))
