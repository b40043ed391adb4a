"""Norfair as a process: `python -m benchmarks.field_peers.norfair_trackers`.

Centers of boxes, re-identified by the cosine of the embeddings, with the numbers of its demo of
re-identification (`published`), or such that what is lost can be found again without end
(`for-ever`). It recognizes in the second frame at the earliest.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from norfair import Detection, Tracker  # pyright: ignore[reportMissingImports]

from benchmarks.field_peers.neutral import FOR_EVER, Seen, Update, identities, serve

_MOST_REID = 0.5
OPTIONS: dict[str, dict[str, Any]] = {
    "published": {"reid_hit_counter_max": 500},
    "for-ever": {"reid_hit_counter_max": FOR_EVER},
}


def embedding_distance(new: Any, lost: Any) -> float:
    """One minus the largest cosine of what is kept of two tracks."""
    ours = np.stack([one.embedding for one in new.past_detections])
    theirs = np.stack([one.embedding for one in (*lost.past_detections, lost.last_detection)])
    return float(1 - np.max(ours @ theirs.T))


def make(options: dict[str, Any]) -> Update:
    """A new tracker."""
    tracker = Tracker(
        distance_function="euclidean",
        distance_threshold=50,  # pixels
        initialization_delay=1,
        hit_counter_max=10,
        past_detections_length=5,
        reid_distance_function=embedding_distance,
        reid_distance_threshold=_MOST_REID,
        **options,
    )

    def update(seen: Seen) -> np.ndarray:
        given = [
            Detection(
                points=box.reshape(2, 2).mean(axis=0, keepdims=True),
                scores=score[None],
                data=row,
                label=int(kind),
                embedding=vector,
            )
            for row, (box, score, kind, vector) in enumerate(
                zip(seen.boxes, seen.scores, seen.classes, seen.embeddings, strict=True)
            )
        ]
        now = {id(one) for one in given}
        told = [
            (one.last_detection.data, one.id)
            for one in tracker.update(given)
            if id(one.last_detection) in now
        ]
        return identities(len(seen), [row for row, _ in told], [number for _, number in told])

    return update


if __name__ == "__main__":
    serve(
        {
            f"Norfair.{setting}": lambda _, options=options: make(options)
            for setting, options in OPTIONS.items()
        },
        ("norfair", "numpy"),
    )
