"""Trackers of Roboflow as a process: `python -m benchmarks.field_peers.trackers_trackers`.

2.6.1 has no tracker that takes embeddings. Settings: `published` as the package sets them, for 30
frames per second; `open` with a memory without end and an answer in the first frame.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import supervision as sv
import trackers  # pyright: ignore[reportMissingImports]

from benchmarks.field_peers.neutral import FOR_EVER, UNANSWERED, Seen, Update, identities, serve

CLASSES: dict[str, Any] = {
    "ByteTrack": trackers.ByteTrackTracker,
    "BoT-SORT": trackers.BoTSORTTracker,
    "OC-SORT": trackers.OCSORTTracker,
}
OPTIONS: dict[str, dict[str, Any]] = {
    "published": {},
    "open": {"lost_track_buffer": FOR_EVER, "minimum_consecutive_frames": 1},
}


def make(name: str, options: dict[str, Any]) -> Update:
    """A new tracker."""
    tracker = CLASSES[name](**options)
    takes_picture = name == "BoT-SORT"  # for the motion of the camera

    def update(seen: Seen) -> np.ndarray:
        given = sv.Detections(
            xyxy=seen.boxes,
            confidence=seen.scores,
            class_id=seen.classes,
            data={"row": np.arange(len(seen))},
        )
        told = tracker.update(given, frame=seen.picture) if takes_picture else tracker.update(given)
        if not len(told):
            return identities(len(seen), [], [])
        ids = np.where(told.tracker_id >= 0, told.tracker_id, UNANSWERED)
        return identities(len(seen), told.data["row"], ids)

    return update


if __name__ == "__main__":
    serve(
        {
            f"{name}.{setting}": lambda _, name=name, options=options: make(name, options)
            for name in CLASSES
            for setting, options in OPTIONS.items()
        },
        ("trackers", "supervision", "numpy"),
    )
