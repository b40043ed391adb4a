"""Tables of a run: `tracks.csv` with every detection, and those that scorers read."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from remind_jax import files
from remind_jax.decision import NO_ID, Outcome, Reason, Status
from remind_jax.files.csv_cells import csv_text
from remind_jax.formats.coco_tracks import coco_video
from remind_jax.formats.mot import mot_lines, mots_lines
from remind_jax.outputs.store import FrameWriter
from remind_jax.tracks import Tracks

# Columns of `tracks.csv`: a value of a detection by frame and row.
_CSV: dict[str, Callable[[Tracks, int], Any]] = {
    "frame": lambda tracks, row: int(tracks.frame_index),
    "source_index": lambda tracks, row: int(tracks.source_index),
    "time_s": lambda tracks, row: round(float(tracks.time_s), 6),
    "name": lambda tracks, row: tracks.name,
    "detection": lambda tracks, row: row,
    "label": lambda tracks, row: tracks.labels[row],
    "outcome": lambda tracks, row: Outcome(tracks.outcome[row]).name.lower(),
    "reason": lambda tracks, row: Reason(tracks.reason[row]).name.lower(),
    "object_id": lambda tracks, row: int(tracks.object_id[row]),
    "pending_id": lambda tracks, row: int(tracks.pending_id[row]),
    "status": lambda tracks, row: Status(tracks.status[row]).name.lower(),
    "score": lambda tracks, row: _round(tracks.shown_score(row)),
    "confidence": lambda tracks, row: _round(tracks.shown_confidence(row)),
    "candidates": lambda tracks, row: _list_candidates(tracks, row),
    "left": lambda tracks, row: round(float(tracks.boxes[row, 0]), 2),
    "top": lambda tracks, row: round(float(tracks.boxes[row, 1]), 2),
    "right": lambda tracks, row: round(float(tracks.boxes[row, 2]), 2),
    "bottom": lambda tracks, row: round(float(tracks.boxes[row, 3]), 2),
    "area": lambda tracks, row: int(tracks.areas[row]),
    "detector_score": lambda tracks, row: _round(float(tracks.detector_scores[row])),
    "object_name": lambda tracks, row: tracks.names.get(int(tracks.object_id[row])),
}
CSV_COLUMNS = tuple(_CSV)


def detection_rows(tracks: Tracks) -> list[dict[str, Any]]:
    """The rows of `tracks.csv` for one frame, one per detection; pixels, seconds, None: empty."""
    return [
        {name: value(tracks, row) for name, value in _CSV.items()} for row in range(len(tracks))
    ]


def _list_candidates(tracks: Tracks, row: int) -> str:
    ids, scores = tracks.candidate_id[row].tolist(), tracks.candidate_score[row].tolist()
    pairs = zip(ids, scores, strict=True)
    return ";".join(f"{i}:{score:.4g}" for i, score in pairs if i != NO_ID)


def _round(value: float | None) -> float | None:
    return None if value is None else round(value, 6)


def csv_writer(path: Path, *, append: bool = False) -> FrameWriter:
    """Writes `tracks.csv`; text is guarded (`files/csv_cells.py`)."""
    return FrameWriter(
        path,
        csv_text([CSV_COLUMNS]),
        lambda tracks: csv_text(row.values() for row in detection_rows(tracks)),
        append=append,
    )


def write_tables(
    folder: Path, tracks: Sequence[Tracks], class_names: Sequence[str], name: str, fps: float
) -> None:
    """Writes `mot.txt`, `mots.txt` and `coco_video.json`."""
    content = coco_video(tracks, class_names, name, fps)
    texts = {
        "mot.txt": "".join(f"{line}\n" for line in mot_lines(tracks)),
        "mots.txt": "".join(f"{line}\n" for line in mots_lines(tracks)),
        "coco_video.json": json.dumps(content, ensure_ascii=False, separators=(",", ":")),
    }
    for file_name, text in texts.items():
        files.replace_file(folder / file_name, text.encode("utf-8"))
