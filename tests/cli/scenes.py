"""Tiny inputs for the command line: a few objects on small frames, as files of every kind."""

import json
from collections.abc import Iterable
from pathlib import Path

import cv2
import numpy as np

from remind_jax.session.live import Tracker
from remind_jax.tracks import Tracks
from tests.sources import making

# Objects of fewer than about 14 patches are too small to be remembered, hence 25 patches each.
PATCH_PX = 16
WIDTH_PX, HEIGHT_PX = 16 * PATCH_PX, 12 * PATCH_PX
OBJECT_PX = 5 * PATCH_PX
CLASSES = {1: "cup", 2: "cup", 3: "book", 4: "vase"}
_PLACES = {1: (8, 8), 2: (8, 136), 3: (104, 8), 4: (104, 136)}  # top, left in the first frame
FIRST_THREE = (1, 2, 3)


def picture(index: int, ids: tuple[int, ...] = FIRST_THREE) -> tuple[np.ndarray, np.ndarray]:
    """RGB image and instance map of a frame: textured squares that drift to the right."""
    noise = np.random.default_rng(0).integers(0, 12, (HEIGHT_PX, WIDTH_PX, 3), np.uint8)
    image, labels = 90 + noise, np.zeros((HEIGHT_PX, WIDTH_PX), np.uint8)
    for instance in ids:
        top, left = _PLACES[instance]
        texture = np.random.default_rng(instance).integers(0, 255, (6, 6, 3), np.uint8)
        left += 2 * min(index, 12)
        window = np.s_[top : top + OBJECT_PX, left : left + OBJECT_PX]
        image[window] = cv2.resize(texture, (OBJECT_PX, OBJECT_PX), interpolation=cv2.INTER_CUBIC)
        labels[window] = instance
    return image, labels


def follow(
    tracker: Tracker, frames: Iterable[int], ids: tuple[int, ...] = FIRST_THREE
) -> list[Tracks]:
    """What a tracker answers about these frames."""
    return [tracker.update(*picture(index, ids)) for index in frames]


def masks_of(labels: np.ndarray) -> np.ndarray:
    """The masks `[N, H, W]` of an instance map."""
    return labels == np.unique(labels)[1:, None, None]


def write_scene(
    folder: Path, num: int = 4, *, seen: dict[int, tuple[int, ...]] | None = None
) -> tuple[Path, Path]:
    """Writes `images/` and `masks/` with metadata; returns both folders.

    `seen` gives the objects in view of single frames; elsewhere it is the first three.
    """
    images, masks = folder / "images", folder / "masks"
    for index in range(num):
        image, labels = picture(index, (seen or {}).get(index, FIRST_THREE))
        making.write_image(images / f"{index:04d}.png", image)
        making.write_image(masks / f"{index:04d}.png", labels)
    names = {str(instance): name for instance, name in CLASSES.items()}
    (masks / "metadata.json").write_text(json.dumps({"id_to_class": names}))
    return images, masks
