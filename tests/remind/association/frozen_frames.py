"""Frames whose decisions were worked out elsewhere.

`frames.npz`: by an independent plain implementation of the rules that agrees with the original.
Half of the frames have the published thresholds, half have some of their own.

`switches.npz`: by the original itself, each with one switch set as it is not shipped, and some
thresholds of their own. Kept were frames that the switch decides otherwise, three of each value.

Inputs are stored in 1/1024; the coverage density is stored raw.
"""

from __future__ import annotations

import dataclasses
import functools
import json
from pathlib import Path
from typing import Any

import jax
import numpy as np

from remind_jax.config import Config
from remind_jax.remind.thresholds import Thresholds
from tests.remind.association.tables import Frame, empty_frame

GOLDEN = Path(__file__).parents[2] / "golden" / "association"
UNIT = 1024


@functools.cache
def _stored(name: str) -> dict[str, np.ndarray]:
    with np.load(GOLDEN / f"{name}.npz") as stored:
        return {name: stored[name] for name in stored.files}


def load_frames(name: str = "frames") -> list[Frame]:
    paths, structure = jax.tree_util.tree_flatten_with_path(empty_frame(1, 1))
    leaves = []
    for path, _ in paths:
        value = _stored(name)["frame." + jax.tree_util.keystr(path, simple=True, separator=".")]
        if value.dtype == np.int16:
            value = value / UNIT
        leaves.append(value if value.dtype != np.int8 else value.astype(np.int32))
    frames = jax.tree.unflatten(structure, leaves)
    low, high = 0.15, 0.60  # share of a patch that counts as nothing, and as everything
    ramps = {
        name: np.clip((getattr(frames.quality, name) - low) / (high - low), 0, 1)
        for name in ("object_density", "parts_density")
    }
    frames = dataclasses.replace(frames, quality=dataclasses.replace(frames.quality, **ramps))
    num = len(frames.class_id)
    return [jax.tree.map(lambda leaf, row=row: leaf[row], frames) for row in range(num)]


def load_settings(name: str) -> list[dict[str, Any]]:
    """What is set otherwise in each frame, by dotted key."""
    return json.loads(str(_stored(name)["settings"]))


def load_thresholds() -> list[Thresholds]:
    """The thresholds of each frame of `frames.npz`."""
    thresholds = []
    for changed in load_settings("frames"):
        tree: dict[str, Any] = {}
        for key, value in changed.items():
            section, name = key.split(".")
            tree.setdefault(section, {})[name] = value
        thresholds.append(Config().updated({"thresholds": tree}).thresholds)
    return thresholds


def load_expected(name: str = "frames") -> dict[str, np.ndarray]:
    """Name -> values with a leading axis of frames."""
    prefix = "expected."
    return {
        key.removeprefix(prefix): value
        for key, value in _stored(name).items()
        if key.startswith(prefix)
    }
