"""Output folders of `remind run` as `TrackRows`, with firm ids or with all detections numbered."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import msgspec
import numpy as np
from jaxtyping import Int

from remind_jax.decision import NO_ID
from remind_jax.errors import SourceError
from remind_jax.files.records import read_lines
from remind_jax.formats.firm import keep_unique
from remind_jax.formats.rows import Row, TrackRows, collect_rows
from remind_jax.tracks import Tracks

RUN_FILE = "detections.jsonl"


def holds_run(folder: Path) -> bool:
    """Whether a folder holds the record of a run, maybe damaged, and not input of that name."""
    path = folder / RUN_FILE
    if not path.is_file():
        return False
    try:
        _, first = next(read_lines(path), (0, b""))
        return "detections" not in msgspec.json.decode(first, type=dict[str, msgspec.Raw])
    except (SourceError, msgspec.DecodeError, RecursionError):
        return True


def read_tracks(folder: Path) -> Sequence[Tracks]:
    """The frames of a run. Raises OutputError if it is none, damaged, or frames are missing."""
    from remind_jax.outputs import store

    return store.read_run(folder)[1]


def read_run_rows(folder: Path, name: str) -> TrackRows:
    """The firm identities of a run."""
    tracks = read_tracks(folder)
    return rows_of_tracks(tracks, [frame.object_id for frame in tracks], name)


def number_detections(tracks: Sequence[Tracks], name: str) -> TrackRows:
    """All detections of a run, decided or not, each under its number in the run as its id."""
    stops = np.cumsum([len(frame) for frame in tracks])
    ids = [np.arange(stop - len(f), stop) for f, stop in zip(tracks, stops, strict=True)]
    return rows_of_tracks(tracks, ids, name)


def rows_of_tracks(
    tracks: Sequence[Tracks], labels: Sequence[Int[np.ndarray, "_"]], name: str
) -> TrackRows:
    """The detections of a run that carry an id, each id once per frame (the better score).

    Ids are given per frame; frames that the run skipped keep their place.
    """
    class_names = sorted({label for frame in tracks for label in frame.labels})
    index = {label: place for place, label in enumerate(class_names)}
    num_frames = tracks[-1].frame_index + 1 if tracks else 0
    names, source_frames = [""] * num_frames, np.full(num_frames, NO_ID)
    rows: list[Row] = []
    for frame, ids in zip(tracks, labels, strict=True):
        names[frame.frame_index] = frame.name
        source_frames[frame.frame_index] = frame.source_index
        for row in np.flatnonzero(keep_unique(ids, frame.score)):
            class_id = index[frame.labels[row]]
            rows.append((frame.frame_index, int(ids[row]), class_id, frame.rles[row], None))
    return collect_rows(
        name,
        num_frames,
        rows,
        class_names=tuple(class_names),
        frame_names=tuple(names),
        frame_size=tracks[0].frame_size if tracks else None,
        is_sampled=True,
        source_frames=source_frames,
    )
