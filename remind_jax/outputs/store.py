"""`detections.jsonl` and `run.json`: the complete record of a run, from which all else is drawn.

Written line by line; a last line cut off in the middle is left out when it is read.
"""

from __future__ import annotations

import contextlib
import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

from remind_jax.errors import OutputError
from remind_jax.files import check_regular, replace_file, writing
from remind_jax.files.records import decode_json, read_json, read_lines
from remind_jax.outputs.run_records import (
    FrameRow,
    RunInfo,
    RunRecord,
    StartRow,
    tracks_of,
    tracks_to_json,
)
from remind_jax.tracks import Tracks

DETECTIONS_NAME = "detections.jsonl"
RUN_NAME = "run.json"
FORMAT = "remind-jax detections"
VERSION = 1

_RESTORE = "run the tracker again or restore the file"
_LIST_OF_NUMBERS = re.compile(r"\[\s+((?:-?[\d.eE+-]+,?\s+)+)\]")


class FrameWriter(contextlib.AbstractContextManager):
    """Writes text frame by frame; every frame is on disk when `add` returns.

    A new file begins with `head`; to the end of another one frames are added.
    """

    def __init__(
        self, path: Path, head: str, text_of: Callable[[Any], str], *, append: bool = False
    ) -> None:
        self._path, self._text_of = path, text_of
        with writing(path):
            self._file = path.open("a" if append else "w", encoding="utf-8", newline="\n")
            if not append:
                self._file.write(head)
                self._file.flush()

    def add(self, frame: Any) -> None:
        """Appends one frame, or what is known of it, as `text_of` takes it."""
        with writing(self._path):
            self._file.write(self._text_of(frame))
            self._file.flush()

    def close(self) -> None:
        """Closes the file."""
        with writing(self._path):
            self._file.close()

    def __exit__(self, *raised: object) -> None:
        self.close()


def detections_writer(path: Path, info: RunInfo, *, append: bool = False) -> FrameWriter:
    """Writes `detections.jsonl`."""
    head = _to_line({"format": FORMAT, "version": VERSION, "info": info.to_json()})
    return FrameWriter(path, head, lambda tracks: _to_line(tracks_to_json(tracks)), append=append)


def _to_line(content: dict[str, Any]) -> str:
    return json.dumps(content, ensure_ascii=False, separators=(",", ":")) + "\n"


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


def read_detections(path: Path) -> tuple[RunInfo, tuple[Tracks, ...]]:
    """Reads `detections.jsonl`: the description of the run and its frames.

    A last line without its end (the run was killed while writing it) is left out.

    Raises:
      OutputError: If the file is missing, of another kind, or damaged before its last line.
    """
    if not path.is_file():
        try:
            check_regular(path.parent if path.parent.is_file() else path)
            why = "it is a folder" if path.exists() else _say_lacking(path)
        except OSError as error:
            why = _say_lacking(path) if isinstance(error, FileNotFoundError) else error.strerror
        raise OutputError(f"'{path.parent}' is not the output folder of a run: {why}")
    lines = read_lines(path, refused=OutputError)
    _, first = next(lines, (0, b""))
    if not first.endswith(b"\n"):
        raise OutputError(f"'{path}' holds no run; run the tracker again")
    info = _read_start(path, first)
    frames: list[Tracks] = []
    for number, line in lines:
        if not line.endswith(b"\n"):
            break
        where = f"'{path}', line {number}"
        frame = decode_json(line, FrameRow, where, refused=OutputError)
        if frames and frame.frame <= frames[-1].frame_index:
            raise OutputError(
                f"{where} is of frame {frame.frame} after frame {frames[-1].frame_index}; "
                f"{_RESTORE}"
            )
        try:
            frames.append(tracks_of(frame))
        except OutputError as error:
            raise OutputError(f"{where}: {error}; {_RESTORE}") from error
    return info, tuple(frames)


def read_run(folder: Path) -> tuple[RunInfo, tuple[Tracks, ...], RunRecord | None]:
    """Reads the record of a run, and `run.json`: None if the run ended before it was written.

    Raises:
      OutputError: If the folder holds no run, the run is damaged, or it is complete and frames are
        missing from its record.
    """
    info, tracks = read_detections(folder / DETECTIONS_NAME)
    run = read_run_json(folder / RUN_NAME)
    counted = run.summary if run is not None and run.complete else None
    if counted is not None and counted.frames != len(tracks):
        raise OutputError(
            f"'{folder / DETECTIONS_NAME}' holds {len(tracks)} frames, and '{RUN_NAME}' beside it "
            f"counts {counted.frames}; {_RESTORE}"
        )
    return info, tracks, run


def write_run_json(path: Path, content: dict[str, Any]) -> None:
    """Writes `run.json` at once or not at all; lists of numbers stay on one line."""
    text = json.dumps(content, indent=2, ensure_ascii=False)
    text = _LIST_OF_NUMBERS.sub(lambda match: f"[{' '.join(match[1].split())}]", text)
    replace_file(path, (text + "\n").encode("utf-8"))


def read_run_json(path: Path) -> RunRecord | None:
    """Reads `run.json`; None if the run ended before it was written."""
    if not path.exists():
        return None
    try:
        return read_json(path, RunRecord, refused=OutputError)
    except OutputError as error:
        raise OutputError(
            f"{error}, or delete the file to open the run without its timings"
        ) from error


def _read_start(path: Path, line: bytes) -> RunInfo:
    """The description of the run, from the first line."""
    where = f"'{path}', line 1"
    try:
        start = decode_json(line, StartRow, where, refused=OutputError)
    except OutputError as error:
        raise OutputError(
            f"'{path}' is not a file of detections written by remind-jax, or damaged: {error}"
        ) from error
    if start.format != FORMAT:
        raise OutputError(f"'{path}' is not a file of detections written by remind-jax")
    if start.version > VERSION:
        raise OutputError(
            f"'{path}' has format version {start.version}, this remind-jax reads up to {VERSION}; "
            "upgrade remind-jax"
        )
    return decode_json(bytes(start.info), RunInfo, where, refused=OutputError)
