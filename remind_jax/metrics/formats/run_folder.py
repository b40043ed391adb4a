"""Output folders of `remind run` as `TrackRows`, firm identities or all settled ones."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
from jaxtyping import Int

from remind_jax.decision import NO_ID
from remind_jax.metrics.formats.rows import RowCollector, TrackRows
from remind_jax.metrics.uncertainty import keep_unique_labels
from remind_jax.tracks import Tracks


def rows_of_tracks(
    tracks: Sequence[Tracks], labels: Sequence[Int[np.ndarray, "N"]], name: str
) -> TrackRows:
    """The detections of a run that carry an id, each id once per frame (the better score).

    Args:
      tracks: Frames of the run; frames that it skipped keep their place.
      labels: Id per detection of every frame, NO_ID without one.
      name: Of the scene.
    """
    class_names = sorted({label for frame in tracks for label in frame.labels})
    index = {label: place for place, label in enumerate(class_names)}
    num_frames = tracks[-1].frame_index + 1 if tracks else 0
    names, source_frames = [""] * num_frames, np.full(num_frames, NO_ID)
    rows = RowCollector()
    for frame, ids in zip(tracks, labels, strict=True):
        names[frame.frame_index] = frame.name
        source_frames[frame.frame_index] = frame.source_index
        keep = keep_unique_labels(ids, frame.score) & (ids != NO_ID)
        for row in np.flatnonzero(keep):
            class_id = index[frame.labels[row]]
            rows.add(frame.frame_index, int(ids[row]), class_id, rle=frame.rles[row])
    finished = rows.finish(
        name,
        num_frames,
        class_names=class_names,
        frame_names=names,
        frame_size=tracks[0].frame_size if tracks else None,
    )
    return dataclasses.replace(finished, is_sampled=True, source_frames=source_frames)
