"""The journal of a run: of every frame what the run collected, so that it can be collected again.

A file of lines of JSON: a header that says what the run is made with, then one line per frame. With
the memory after the last of these frames and the pictures of the source, a run goes on as if it had
never stopped.
"""

from __future__ import annotations

import dataclasses
import json
import os
import zlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

import msgspec
import numpy as np

from remind_jax.config import Config
from remind_jax.errors import OutputError, SourceError
from remind_jax.files import replace_file, writing
from remind_jax.files.records import Count, Label, Small, Whole, decode_json, read_lines
from remind_jax.frame import Frame
from remind_jax.masks.run_length import encode_masks
from remind_jax.outputs.run_info import Event
from remind_jax.outputs.run_records import (
    EventRecord,
    FrameRow,
    Milliseconds,
    check_masks,
    tracks_of,
)
from remind_jax.outputs.store import tracks_to_json
from remind_jax.session.preparation import wanted_detections
from remind_jax.tracks import Tracks

JOURNAL_NAME = "frames.jsonl"
FORMAT = "remind-jax journal"
VERSION = 1
_CHUNK_BYTES = 1 << 20


@dataclasses.dataclass(frozen=True)
class Step:
    """What a run collected of one frame."""

    tracks: Tracks  # as decided
    checksum: int  # of the picture or the features
    timings_ms: Mapping[str, float]  # by stage
    compile_s: float  # waited for programs in the run so far
    first_frame_ms: float | None = None  # of the first frame only
    merges: Sequence[tuple[int, int]] = ()  # objects that turned out to be others
    evidence: Mapping[str, Any] | None = None  # what delayed answers are revised by
    events: Sequence[Event] = ()
    has_grown: bool = False
    dropped: Mapping[str, int] = dataclasses.field(default_factory=dict)  # by the detector
    attention_slots: int = 0

    def to_json(self) -> dict[str, Any]:
        """The same as a dictionary that `json` can write."""
        fields = {field.name: getattr(self, field.name) for field in dataclasses.fields(self)}
        return fields | {
            "tracks": tracks_to_json(self.tracks),
            "types": {
                name: value.dtype.str
                for name, value in vars(self.tracks).items()
                if isinstance(value, np.ndarray)
            },
            "events": [dataclasses.asdict(event) for event in self.events],
        }

    @classmethod
    def of(cls, row: StepRow) -> Step:
        """From what `to_json` made, as it was read.

        Raises:
          OutputError: If its parts do not fit together.
        """
        tracks = tracks_of(row.tracks)
        check_masks([tracks])
        # In other types pictures would be cut out and drawn a little differently.
        arrays = {
            name: getattr(tracks, name).astype(kind)
            for name, kind in row.types.items()
            if isinstance(getattr(tracks, name, None), np.ndarray)
        }
        values = {name: getattr(row, name) for name in row.__struct_fields__ if name != "types"}
        return cls(
            **{
                **values,
                "tracks": dataclasses.replace(tracks, **arrays),
                "events": [
                    Event(event.frame_index, event.kind, event.message) for event in row.events
                ],
            }
        )


class StepRow(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """One line of the journal; see `Step`."""

    tracks: FrameRow
    types: dict[Label, Literal["<i4", "<i8", "<f4", "<f8"]]  # of the arrays in `tracks`
    checksum: Whole
    timings_ms: dict[Label, Milliseconds]
    compile_s: Milliseconds
    first_frame_ms: Milliseconds | None
    merges: list[tuple[Small, Small]]
    evidence: dict[Label, list[Small]] | None
    events: list[EventRecord]
    has_grown: bool
    dropped: dict[Label, Count]
    attention_slots: Count


class JournalWriter:
    """Appends steps; they are on disk when `flush` returns, and not before."""

    def __init__(self, path: Path) -> None:
        self._path, self._lines = path, []

    @classmethod
    def begin(cls, path: Path, header: Mapping[str, Any]) -> JournalWriter:
        """A new journal in the place of any other.

        Raises:
          OutputError: If it cannot be written.
        """
        content = {"format": FORMAT, "version": VERSION, **header}
        replace_file(path, _line(content))
        return cls(path)

    def add(self, step: Step) -> None:
        """Takes one frame."""
        self._lines.append(_line(step.to_json()))

    def flush(self) -> None:
        """Writes what was taken.

        Raises:
          OutputError: If it cannot be written.
        """
        with writing(self._path), self._path.open("ab") as file:
            file.write(b"".join(self._lines))
            file.flush()
            os.fsync(file.fileno())
        self._lines.clear()


@dataclasses.dataclass(frozen=True)
class Journal:
    """A journal as read."""

    path: Path
    header: dict[str, Any]
    lines: tuple[bytes, ...]  # of the frames, whole ones only

    @classmethod
    def read(cls, path: Path) -> Journal | None:
        """Reads a journal; None if there is none, or it was killed before its header.

        Raises:
          OutputError: If it is something else, or of a later version.
        """
        if not path.is_file():
            return None
        lines = [line for _, line in read_lines(path, refused=OutputError)]
        if lines and not lines[-1].endswith(b"\n"):
            lines.pop()
        if not lines:
            return None
        header = decode_json(lines[0], dict[str, Any], f"'{path}', line 1", refused=OutputError)
        if header.get("format") != FORMAT:
            raise OutputError(f"'{path}' is not the journal of a run; {_START_ANEW}")
        if header.get("version") != VERSION:
            raise OutputError(
                f"'{path}' has version {header.get('version')}, this remind-jax reads version "
                f"{VERSION}; {_START_ANEW}"
            )
        return cls(path, header, tuple(lines[1:]))

    def steps(self, num: int) -> list[Step]:
        """The first frames.

        Raises:
          OutputError: If there are fewer, or one is damaged.
        """
        if num > len(self.lines):
            raise OutputError(
                f"'{self.path}' has {len(self.lines)} frames, the memory beside it has seen {num}; "
                f"{_START_ANEW}"
            )
        steps = []
        for number, line in enumerate(self.lines[:num], start=2):
            where = f"'{self.path}', line {number}"
            row = decode_json(line, StepRow, where, refused=OutputError)
            try:
                steps.append(Step.of(row))
            except OutputError as error:
                raise OutputError(f"{where}: {error}; {_START_ANEW}") from error
        return steps

    def go_on(self, num: int) -> JournalWriter:
        """Leaves out all frames but the first ones; what is added follows them.

        Raises:
          OutputError: If it cannot be written.
        """
        replace_file(self.path, b"".join([_line(self.header), *self.lines[:num]]))
        return JournalWriter(self.path)


_START_ANEW = "start the run anew with --overwrite"


def checksum_of(frame: Frame) -> int:
    """Changes with the picture or the features of a frame; equal on every machine."""
    checksum = 0
    for array in (frame.image, frame.features):
        if array is not None:
            checksum = zlib.crc32(np.ascontiguousarray(array).data, checksum)
    return checksum


def check_frame(
    step: Step, frame: Frame, checksum: int, config: Config, has_detector: bool
) -> None:
    """Makes sure that a frame is the one that was decided then, with the same masks.

    Args:
      step: What was collected of it.
      frame: As the source gives it now.
      checksum: Of this frame.
      config: Ignored classes are read.
      has_detector: Whether detections came from a detector, which is not asked again.

    Raises:
      SourceError: If it is another one.
    """
    was, what = step.tracks, None
    if (was.source_index, was.name, was.frame_size) != (frame.source_index, frame.name, frame.size):
        what = f"in its place was frame {was.source_index} ('{was.name}')"
    elif step.checksum != checksum:
        what = "its picture was another one"
    elif not has_detector:
        seen, _ = wanted_detections(frame, config)
        same = (
            seen.labels == was.labels
            and np.array_equal(seen.scores, np.asarray(was.detector_scores, np.float32))
            and [code["counts"] for code in encode_masks(seen.masks)]
            == [code["counts"] for code in was.rles]
        )
        what = None if same else "its masks were others"
    if what is not None:
        raise SourceError(
            f"frame {frame.source_index} ('{frame.name}') is not what the run was begun with: "
            f"{what}; give the same source, or start the run anew with --overwrite"
        )


def checksum_of_file(path: str | Path) -> int:
    """Changes with the content of a file.

    Raises:
      OSError: If it cannot be read.
    """
    checksum = 0
    with Path(path).open("rb") as file:
        while chunk := file.read(_CHUNK_BYTES):
            checksum = zlib.crc32(chunk, checksum)
    return checksum


def _line(content: Mapping[str, Any]) -> bytes:
    return (json.dumps(content, separators=(",", ":")) + "\n").encode("ascii")
