"""Twelve rendered tours, four questions at three levels of difficulty each, for evaluation only.

Nothing may be tuned on them, nor on any tour of a seed from 100 on.
"""

from __future__ import annotations

import dataclasses
import hashlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

from remind_jax import synthetic
from remind_jax.files import remove_unfinished, replacing_folder, user_cache_folder
from remind_jax.synthetic import LookalikeGroup, SceneOptions, make_scene, write_davis
from remind_jax.synthetic.shapes import CLASSES

FIRST_SEED = 100  # tours of this seed and later ones are for evaluation only
AXES = ("alike", "absent", "light", "dense")  # what makes a tour hard; three tours each

# Few classes: what has no rival of its class, its class name alone would recognize.
_CLASSES = ("mug", "box", "vase", "bottle", "book", "bowl", "can", "plant")
_FEW = (LookalikeGroup("mug", 3, "glaze"), LookalikeGroup("box", 2, "identical", rooms=(0, 1)))
_MANY = (
    LookalikeGroup("mug", 4, "tint", rooms=(0, 1)),
    LookalikeGroup("box", 4, "identical", rooms=(0, 1)),
    LookalikeGroup("vase", 4, "tint", rooms=(0, 1)),
    LookalikeGroup("bottle", 4, "pattern", rooms=(0, 1)),
    LookalikeGroup("book", 4, "identical", rooms=(0, 1)),
)
_BASE = SceneOptions(
    width=480,
    height=360,
    min_mask_px=200,  # most of a patch of 16 pixels
    frames=180,
    num_rooms=2,
    objects_per_room=14,
    classes=_CLASSES,
    lookalikes=_FEW,
    absence_frames=70,
    light_drop=0.3,
)
_VARIANTS: tuple[tuple[str, dict[str, Any]], ...] = (
    ("alike-1", {"lookalikes": (), "classes": tuple(CLASSES)}),
    ("alike-2", {}),
    ("alike-3", {"lookalikes": _MANY, "classes": _CLASSES[:5]}),
    ("absent-1", {"absence_frames": 30}),
    ("absent-2", {"absence_frames": 60, "returns": 2, "frames": 240}),
    ("absent-3", {"absence_frames": 150, "frames": 260, "num_rooms": 3}),
    ("light-1", {"light_drop": 1.0}),
    ("light-2", {"light_drop": 0.12}),
    ("light-3", {"light_drop": 0.04, "window_level": 0.1, "noise": 4.0}),
    ("dense-1", {"objects_per_room": 8, "gap_m": 0.15}),
    ("dense-2", {"objects_per_room": 19, "gap_m": 0.03}),
    ("dense-3", {"objects_per_room": 25, "gap_m": 0.01}),
)


def benchmark_tours() -> tuple[SceneOptions, ...]:
    """Options of the twelve tours, `<axis>-<level>`; level 3 is the hardest."""
    return tuple(
        dataclasses.replace(_BASE, name=name, seed=FIRST_SEED + number, **changes)
        for number, (name, changes) in enumerate(_VARIANTS)
    )


def render_tours(
    folder: str | Path | None = None,
    tours: tuple[SceneOptions, ...] | None = None,
    progress: Callable[[str], None] | None = None,
) -> Path:
    """Renders what is not there yet, in the DAVIS layout, and gives the folder."""
    tours = benchmark_tours() if tours is None else tours
    base = user_cache_folder() / "tours" if folder is None else Path(folder)
    # Another renderer or other options make other pixels, which belong into another folder.
    root = base / _fingerprint(tours)
    remove_unfinished(root)
    for options in tours:
        if (root / options.name / "metadata.json").is_file():
            continue
        if progress is not None:
            progress(options.name)
        with replacing_folder(root / options.name, root) as folder:
            write_davis(make_scene(options), folder)
    return root


def _fingerprint(tours: tuple[SceneOptions, ...]) -> str:
    digest = hashlib.sha256(repr(tours).encode())
    for file in sorted(Path(str(synthetic.__file__)).parent.glob("*.py")):
        digest.update(file.read_bytes())
    return digest.hexdigest()[:12]
