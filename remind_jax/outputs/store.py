"""`detections.jsonl` and `run.json`: the complete record of a run, from which all else is drawn.

`detections.jsonl` starts with a header line (the description of the run) and has one line per
processed frame. It is written line by line, so that a run that is killed keeps all frames but
the one being written; a last line cut off in the middle is left out when it is read.
"""

from __future__ import annotations

import contextlib
import json
import math
import re
from pathlib import Path
from typing import Any

import numpy as np

from remind_jax.decision import NO_ID, Outcome, Reason, Status
from remind_jax.errors import OutputError
from remind_jax.files import read_bytes, read_text, replace_file, writing
from remind_jax.frame import Rle
from remind_jax.tracks import Tracks

DETECTIONS_NAME = "detections.jsonl"
RUN_NAME = "run.json"
FORMAT = "remind-jax detections"
VERSION = 1

# Keys of a detection, and the fields of `Tracks` that they are.
_CODES = {"outcome": Outcome, "reason": Reason, "status": Status}
_INTEGERS = {
    "object_id": "object_id",
    "pending_id": "pending_id",
    "area": "areas",
    "instance_id": "instance_ids",
}
_REALS = {"score": "score", "confidence": "confidence", "detector_score": "detector_scores"}

# How values that are not what was written fail to be read.
_DAMAGE = (
    ValueError,
    KeyError,
    TypeError,
    IndexError,
    AttributeError,
    OverflowError,
    RecursionError,
)
_LIST_OF_NUMBERS = re.compile(r"\[\s+((?:-?[\d.eE+-]+,?\s+)+)\]")


class DetectionsWriter(contextlib.AbstractContextManager):
    """Writes `detections.jsonl` frame by frame; every frame is on disk when `add` returns."""

    def __init__(self, path: Path, info: dict[str, Any]) -> None:
        self._path = path
        with writing(path):
            self._file = path.open("w", encoding="utf-8", newline="\n")
            self._write({"format": FORMAT, "version": VERSION, "info": info})

    def add(self, tracks: Tracks) -> None:
        """Appends one frame.

        Raises:
          OutputError: If it cannot be written.
        """
        with writing(self._path):
            self._write(tracks_to_json(tracks))

    def close(self) -> None:
        """Closes the file."""
        with writing(self._path):
            self._file.close()

    def _write(self, content: dict[str, Any]) -> None:
        self._file.write(json.dumps(content, ensure_ascii=False, separators=(",", ":")) + "\n")
        self._file.flush()

    def __exit__(self, *raised: object) -> None:
        self.close()


def tracks_to_json(tracks: Tracks) -> dict[str, Any]:
    """One frame as a dictionary that `json` can write; numbers that are not finite become null."""
    height, width = tracks.frame_size
    return {
        "frame": int(tracks.frame_index),
        "source_index": int(tracks.source_index),
        "time_s": _number(tracks.time_s),
        "name": tracks.name,
        "size": [int(height), int(width)],
        "num_candidates": int(tracks.candidate_id.shape[1]),
        "detections": [_detection_to_json(tracks, row) for row in range(len(tracks))],
    }


def _detection_to_json(tracks: Tracks, row: int) -> dict[str, Any]:
    shown = tracks.candidate_id[row] != NO_ID
    candidates = zip(
        tracks.candidate_id[row, shown].tolist(),
        map(_number, tracks.candidate_score[row, shown]),
        strict=True,
    )
    return {
        "label": tracks.labels[row],
        **{key: kind(getattr(tracks, key)[row]).name.lower() for key, kind in _CODES.items()},
        **{key: int(getattr(tracks, field)[row]) for key, field in _INTEGERS.items()},
        **{key: _number(getattr(tracks, field)[row]) for key, field in _REALS.items()},
        "candidates": [list(pair) for pair in candidates],
        "box": [_number(side) for side in tracks.boxes[row]],
        "rle": tracks.rles[row]["counts"].decode("ascii"),
    }


def tracks_from_json(content: dict[str, Any]) -> Tracks:
    """Reads back one frame; scores come as float64, padding candidates as id -1 and score 0."""
    rows = content["detections"]
    num, width = len(rows), content["num_candidates"]
    candidate_id = np.full((num, width), NO_ID, np.int32)
    candidate_score = np.zeros((num, width))
    for row, detection in enumerate(rows):
        for column, (object_id, score) in enumerate(detection["candidates"]):
            candidate_id[row, column] = object_id
            candidate_score[row, column] = np.nan if score is None else score

    def read(key: str, kind: Any) -> np.ndarray:
        return np.array([row[key] for row in rows], kind)  # of floats, None becomes NaN

    size = (int(content["size"][0]), int(content["size"][1]))
    codes = {
        key: np.array([kind[row[key].upper()] for row in rows], np.int32)
        for key, kind in _CODES.items()
    }
    return Tracks(
        frame_index=content["frame"],
        source_index=content["source_index"],
        time_s=content["time_s"],
        name=content["name"],
        frame_size=size,
        candidate_id=candidate_id,
        candidate_score=candidate_score,
        labels=tuple(row["label"] for row in rows),
        boxes=read("box", float).reshape(num, 4),
        rles=tuple(_rle(size, row["rle"]) for row in rows),
        **codes,
        **{field: read(key, np.int32) for key, field in _INTEGERS.items()},
        **{field: read(key, float) for key, field in _REALS.items()},
    )


def _say_lacking(path: Path) -> str:
    """Why a run cannot be read, and which runs are near."""
    folder = path.parent
    if not folder.exists():
        beside = folder.absolute().parent
        names = [p.parent.name for p in beside.glob(f"*/{path.name}")]
        hint = f"; runs beside it: {', '.join(sorted(names))}" if names else ""
        return f"it does not exist{hint}"
    if not folder.is_dir():
        return "it is a file"
    below = sorted(str(p.parent) for p in folder.glob(f"*/{path.name}"))
    hint = f"; it holds the runs {', '.join(below)}" if below else ""
    return f"it has no '{path.name}'{hint}"


def read_detections(path: Path) -> tuple[dict[str, Any], tuple[Tracks, ...]]:
    """Reads `detections.jsonl`: the description of the run and its frames.

    A last line without its end (the run was killed while writing it) is left out.

    Raises:
      OutputError: If the file is missing, of another kind, or damaged before its last line.
    """
    try:
        lines = read_bytes(path).splitlines(keepends=True)
    except OSError as error:
        raise OutputError(
            f"'{path.parent}' is not the output folder of a run: {_say_lacking(path)}"
        ) from error
    if lines and not lines[-1].endswith(b"\n"):
        lines.pop()
    info: dict[str, Any] | None = None
    frames = []
    for number, line in enumerate(lines, start=1):
        try:
            content = json.loads(line)
            if info is None:
                info = _read_header(path, content)
            else:
                frames.append(tracks_from_json(content))
        except _DAMAGE as error:
            if isinstance(error, OutputError):
                raise
            raise OutputError(
                f"'{path}' is damaged in line {number} ({type(error).__name__}: {error}); run the "
                "tracker again or restore the file"
            ) from error
    if info is None:
        raise OutputError(f"'{path}' holds no run; run the tracker again")
    return info, tuple(frames)


def write_run_json(path: Path, content: dict[str, Any]) -> None:
    """Writes `run.json` at once or not at all; lists of numbers stay on one line.

    Raises:
      OutputError: If it cannot be written.
    """
    text = json.dumps(content, indent=2, ensure_ascii=False)
    text = _LIST_OF_NUMBERS.sub(lambda match: f"[{' '.join(match[1].split())}]", text)
    replace_file(path, (text + "\n").encode("utf-8"))


def read_run_json(path: Path) -> dict[str, Any] | None:
    """Reads `run.json`; None if the run ended before it was written.

    Raises:
      OutputError: If it is damaged.
    """
    if not path.exists():
        return None
    try:
        content = json.loads(read_text(path))
        if not isinstance(content, dict):
            raise ValueError("not an object")
    except (OSError, ValueError, RecursionError) as error:
        raise OutputError(
            f"'{path}' is damaged ({error}); delete it to open the run without its timings"
        ) from error
    return content


def _read_header(path: Path, content: Any) -> dict[str, Any]:
    if not isinstance(content, dict) or content.get("format") != FORMAT:
        raise OutputError(f"'{path}' is not a file of detections written by remind-jax")
    if content["version"] > VERSION:
        raise OutputError(
            f"'{path}' has format version {content['version']}, this remind-jax reads up to "
            f"{VERSION}; upgrade remind-jax"
        )
    return content["info"]


def _rle(size: tuple[int, int], counts: str) -> Rle:
    return {"size": list(size), "counts": counts.encode("ascii")}


def _number(value: Any) -> float | None:
    number = float(value)
    return number if math.isfinite(number) else None
