"""Frames whose decisions were worked out elsewhere.

`frames.npz`: by an independent plain implementation of the rules that agrees with the original.
Half of the frames have the published thresholds, half have some of their own.

`switches.npz`: by the original itself, each with one switch set as it is not shipped, and some
thresholds of their own. Kept were frames that the switch decides otherwise, three of each value.

The coverage density is stored raw.
"""

import dataclasses
import json
from collections.abc import Mapping
from typing import Any

import jax
import numpy as np

from remind_jax.config import Config
from remind_jax.config.dotted_keys import nest
from remind_jax.remind.thresholds import Thresholds
from tests.golden.load import load_cases
from tests.remind.association.tables import Frame, empty_frame


def load_frames(name: str = "frames") -> list[Frame]:
    paths, structure = jax.tree_util.tree_flatten_with_path(empty_frame(1, 1))
    leaves = []
    for path, _ in paths:
        key = "frame." + jax.tree_util.keystr(path, simple=True, separator=".")
        leaves.append(_read(load_cases(f"association/{name}"), key))
    frames = jax.tree.unflatten(structure, leaves)
    low, high = 0.15, 0.60  # share of a patch that counts as nothing, and as everything
    ramps = {
        name: np.clip((getattr(frames.quality, name) - low) / (high - low), 0, 1)
        for name in ("object_density", "parts_density")
    }
    frames = dataclasses.replace(frames, quality=dataclasses.replace(frames.quality, **ramps))
    num = len(frames.class_id)
    return [jax.tree.map(lambda leaf, row=row: leaf[row], frames) for row in range(num)]


def _read(cases: Mapping[str, np.ndarray], key: str) -> np.ndarray:
    """A leaf of all frames; scores of the two banks are stored apart."""
    if not key.startswith("frame.channels."):
        return cases[key]
    head, channel, *field = key.split(".")[1:]
    stored = {"objects": "object"}.get(channel, channel)
    banks = [
        cases[".".join(("frame", head, f"{stored}_{bank}", *field))] for bank in ("work", "stable")
    ]
    return np.stack(banks, axis=1)


def load_settings(name: str) -> list[dict[str, Any]]:
    """What is set otherwise in each frame, by dotted key."""
    return json.loads(str(load_cases(f"association/{name}")["settings"]))


def load_thresholds() -> list[Thresholds]:
    """The thresholds of each frame of `frames.npz`."""
    settings = load_settings("frames")
    return [Config().updated({"thresholds": nest(changed)}).thresholds for changed in settings]
