"""MOTChallenge text (boxes) and MOTS / KITTI-MOTS text (masks) as `TrackRows`.

Two text files of one format are compared by `mot_files` as TrackEval does it; this reader serves
where the other side is of another format, and its class numbers mean nothing there.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from remind_jax.errors import SourceError
from remind_jax.metrics.formats.rows import UNKNOWN_CLASS, TrackRows, boxes_of, size_of
from remind_jax.metrics.mot_files import (
    MAX_FRAMES,
    MOTS_IGNORE_CLASS,
    FileFormat,
    read_mot_rows,
    read_mots_rows,
)


def read_text_rows(path: Path, name: str, format: FileFormat, *, is_truth: bool) -> TrackRows:
    """Reads one file.

    Args:
      path: The file.
      name: Of the scene.
      format: Its format.
      is_truth: Whether flag 0 means "to be ignored" (MOT) and class 10 is an ignore region (MOTS).

    Raises:
      SourceError: If it cannot be read or breaks the rules of its format.
    """
    if format == "mot":
        return _read_boxes(path, name, is_truth=is_truth)
    rows = read_mots_rows(path)
    frame = rows.frame - (0 if format == "kitti-mots" else 1)
    _check_frames(path, frame)
    is_ignored = (rows.class_id == MOTS_IGNORE_CLASS) & is_truth
    kept = rows.select(~is_ignored)
    return TrackRows(
        name=name,
        num_frames=int(frame.max(initial=-1)) + 1,
        frame=frame[~is_ignored],
        track_id=kept.track_id,
        boxes=boxes_of(kept.rles),
        class_id=np.full(len(kept.frame), UNKNOWN_CLASS),
        rles=kept.rles,
        frame_size=size_of(rows.rles[0]) if rows.rles else None,
        ignored_frame=frame[is_ignored],
        ignored_rles=rows.select(is_ignored).rles,
    )


def _read_boxes(path: Path, name: str, *, is_truth: bool) -> TrackRows:
    rows = read_mot_rows(path)
    frame = rows.frame - 1
    _check_frames(path, frame)
    keep = (rows.flag != 0) | (not is_truth)
    return TrackRows(
        name=name,
        num_frames=int(frame.max(initial=-1)) + 1,
        frame=frame[keep],
        track_id=rows.track_id[keep],
        boxes=rows.boxes[keep],
        class_id=np.full(int(keep.sum()), UNKNOWN_CLASS),
    )


def _check_frames(path: Path, frame: np.ndarray) -> None:
    if len(frame) and not 0 <= frame[0] <= frame[-1] < MAX_FRAMES:
        wrong = frame[0] if frame[0] < 0 else frame[-1]
        raise SourceError(
            f"{path}: a row is {wrong} frames after the first; frames are counted from 1 "
            f"(0 in KITTI-MOTS), up to {MAX_FRAMES}"
        )
