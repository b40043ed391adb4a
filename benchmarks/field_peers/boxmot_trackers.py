"""Trackers of BoxMOT as a process: `python -m benchmarks.field_peers.boxmot_trackers`.

They take our embeddings. Settings: `published` as the package configures them; `for-ever` with a
memory without end; `open` also without gates that ask for overlap with the last place, without
filters of boxes, and with an answer in the first frame, where these are settings.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import torch  # pyright: ignore[reportMissingImports]
from boxmot.structures import Boxes, Detections  # pyright: ignore[reportMissingImports]
from boxmot.trackers.factory import create_tracker  # pyright: ignore[reportMissingImports]
from boxmot.trackers.specs import TrackerSpec  # pyright: ignore[reportMissingImports]

from benchmarks.field_peers.neutral import FOR_EVER, Seen, Update, identities, serve

Options = dict[str, Any]
_BOT = {"track_buffer": FOR_EVER}
_AGE = {"max_age": FOR_EVER}
_OCCLU = {**_AGE, "recovery_max_age": FOR_EVER, "gta_max_gap": FOR_EVER}
SETTINGS: dict[str, tuple[str, Options]] = {
    "BoT-SORT.published": ("botsort", {}),
    "BoT-SORT.for-ever": ("botsort", _BOT),
    "BoT-SORT.open": ("botsort", {**_BOT, "proximity_thresh": 1.0}),
    "OccluBoost.published": ("occluboost", {}),
    "OccluBoost.for-ever": ("occluboost", _OCCLU),
    "OccluBoost.open": (
        "occluboost",
        {
            **_OCCLU,
            "recovery_iou_thresh": 0.0,
            "gta_enabled": True,
            "gta_interpolate": False,
            "min_box_area": 0,
            "aspect_ratio_thresh": 1e6,
        },
    ),
    "StrongSORT.published": ("strongsort", {}),
    "StrongSORT.for-ever": ("strongsort", _AGE),
    "StrongSORT.open": ("strongsort", {**_AGE, "n_init": 1}),
    "DeepOCSORT.published": ("deepocsort", {}),
    "DeepOCSORT.for-ever": ("deepocsort", _AGE),
    "DeepOCSORT.open": (
        "deepocsort",
        {**_AGE, "asso_func": "centroid", "iou_threshold": 0.0, "min_hits": 1},
    ),
}


def make(name: str, options: Options) -> Update:
    """A new tracker."""
    tracker = create_tracker(TrackerSpec(name=name, options=tuple(sorted(options.items()))))

    def update(seen: Seen) -> np.ndarray:
        given = Detections(
            geometry=Boxes(torch.from_numpy(seen.boxes)),
            scores=torch.from_numpy(seen.scores),
            class_ids=torch.from_numpy(seen.classes),
            sample_id="frame",
            embeddings=torch.from_numpy(seen.embeddings),
        )
        told = tracker.update(given, seen.picture)
        return identities(len(seen), told.detection_indices.numpy(), told.track_ids.numpy())

    return update


if __name__ == "__main__":
    torch.set_num_threads(1)
    serve(
        {
            key: lambda _, name=name, options=options: make(name, options)
            for key, (name, options) in SETTINGS.items()
        },
        ("boxmot", "torch", "numpy"),
    )
