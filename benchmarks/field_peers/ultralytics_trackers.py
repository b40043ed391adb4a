"""Trackers of Ultralytics as a process: `python -m benchmarks.field_peers.ultralytics_trackers`.

BoT-SORT and TrackTrack get our embeddings as features of the detector (`model: auto`). Settings:
`published` as its files configure them, with re-identification on; `for-ever` with a memory without
end; `open` also without the gate that asks BoT-SORT for overlap with the last place, and with the
second, wider look of TrackTrack for what was lost.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import torch  # pyright: ignore[reportMissingImports]
from ultralytics.engine.results import Boxes  # pyright: ignore[reportMissingImports]
from ultralytics.trackers import BOTSORT, TRACKTRACK, BYTETracker  # pyright: ignore[reportMissingImports]
from ultralytics.utils import YAML, IterableSimpleNamespace  # pyright: ignore[reportMissingImports]
from ultralytics.utils.checks import check_yaml  # pyright: ignore[reportMissingImports]

from benchmarks.field_peers.neutral import FOR_EVER, Seen, Update, identities, serve

Options = dict[str, Any]
_FOR_EVER = {"track_buffer": FOR_EVER}
_LOOKS = {"with_reid": True, "model": "auto"}
SETTINGS: dict[str, tuple[Any, str, Options]] = {
    "ByteTrack.published": (BYTETracker, "bytetrack", {}),
    "ByteTrack.for-ever": (BYTETracker, "bytetrack", _FOR_EVER),
    "BoT-SORT.published": (BOTSORT, "botsort", _LOOKS),
    "BoT-SORT.for-ever": (BOTSORT, "botsort", {**_LOOKS, **_FOR_EVER}),
    "BoT-SORT.open": (BOTSORT, "botsort", {**_LOOKS, **_FOR_EVER, "proximity_thresh": 0.0}),
    "TrackTrack.published": (TRACKTRACK, "tracktrack", _LOOKS),
    "TrackTrack.for-ever": (TRACKTRACK, "tracktrack", {**_LOOKS, **_FOR_EVER}),
    "TrackTrack.open": (
        TRACKTRACK,
        "tracktrack",
        {**_LOOKS, **_FOR_EVER, "lost_match_thr": 0.9, "min_track_len": 1},
    ),
}


def make(kind: Any, file: str, options: Options) -> Update:
    """A new tracker."""
    configured = YAML.load(check_yaml(f"{file}.yaml"))
    tracker = kind(IterableSimpleNamespace(**{**configured, **options}))

    def update(seen: Seen) -> np.ndarray:
        rows = np.column_stack([seen.boxes, seen.scores, seen.classes]).astype(np.float32)
        given = Boxes(rows.reshape(-1, 6), seen.picture.shape[:2])
        told = tracker.update(given, seen.picture, feats=seen.embeddings)
        if not len(told):
            return identities(len(seen), [], [])
        return identities(len(seen), told[:, 7].astype(int), told[:, 4].astype(int))

    return update


if __name__ == "__main__":
    torch.set_num_threads(1)
    serve(
        {key: lambda _, given=given: make(*given) for key, given in SETTINGS.items()},
        ("ultralytics", "torch", "numpy"),
    )
