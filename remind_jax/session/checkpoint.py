"""Checkpoints of a run: its memory beside the frames so far, so that a killed run can go on.

They lie in a folder of their own below that of the run, which is removed when the run is complete:
the memory, and a file of lines of JSON, a header that says what the run is made with, then one line
per frame. A checkpoint counts from the moment when its memory is in place: whatever the file has
beyond the frames that this memory has seen is left out.
"""

from __future__ import annotations

import contextlib
import dataclasses
import shutil
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, Literal

import msgspec

from remind_jax import files
from remind_jax.config.dotted_keys import flatten
from remind_jax.errors import OutputError
from remind_jax.explanation.archive import TraceArchive
from remind_jax.files.records import Count, Label, Small, decode_json, read_lines
from remind_jax.outputs import run_records
from remind_jax.outputs.writer import CHECKPOINT_NAME, MEMORY_NAME
from remind_jax.session.live import Tracker
from remind_jax.tracks import Tracks

EVERY_S = 10.0  # seconds between checkpoints, or more where one is expensive:
MAX_OF_A_RUN = 0.01  # share of the time that they may take
FRAMES_NAME = "frames.jsonl"
# Of the moment, of the end, or of what people changed meanwhile.
_NOT_COMPARED = ("info.started_at", "info.class_names", "info.fps", "info.renamed")
_CODE = "info.options.tracker_code"  # of a method of one's own
_OPTIONS = "info.options"
_START_ANEW = "start the run anew with --overwrite"


class Step(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """What a run collected of one frame, beside what was decided."""

    timings_ms: dict[Label, run_records.Duration]  # by stage
    compile_s: run_records.Duration  # waited for programs in the run so far
    first_frame_ms: run_records.Duration | None = None  # of the first frame only
    merges: list[tuple[Small, Small]] = []  # objects that turned out to be others
    evidence: dict[Label, list[Small]] | None = None  # what delayed answers are revised by
    events: list[run_records.Event] = []
    has_grown: bool = False
    dropped: dict[Label, Count] = {}  # by the detector
    attention_slots: Count = 0


class Header(msgspec.Struct, frozen=True):
    """What a run is made with."""

    format: Literal["remind-jax checkpoint"]
    version: Literal[2]
    info: dict[str, Any]  # `RunInfo`
    start: Count  # frames that the memory has seen before

    @classmethod
    def of(cls, info: run_records.RunInfo, start: int) -> Header:
        """As it is read back."""
        content = msgspec.json.decode(msgspec.json.encode(info.to_json()))
        return cls("remind-jax checkpoint", 2, content, start)

    def check_same(self, now: Header, folder: Path) -> None:
        """Makes sure that a run goes on with what it was begun with.

        Raises:
          OutputError: If something differs; the sentence names the first thing that does.
        """
        was, given = (
            dict(flatten(msgspec.to_builtins(one), with_empty=True)) for one in (self, now)
        )
        if was.get(_CODE) is None or given.get(_CODE) is None:  # nobody can tell
            was[_CODE] = given[_CODE] = None
        if not self.info.get("options"):  # of an earlier version, which does not say
            was.pop(_OPTIONS, None)
            was |= {name: given[name] for name in given if name.startswith(_OPTIONS)}
        for name in dict.fromkeys((*given, *was)):
            if name == "info.known_objects" and was.get(name) != given.get(name):
                raise OutputError(
                    f"the run in '{folder}' was begun with a memory of other objects or other "
                    "names; give that one as it was then (--memory), or start it anew with "
                    "--overwrite"
                )
            if name not in _NOT_COMPARED and was.get(name) != given.get(name):
                raise OutputError(
                    f"the run in '{folder}' was begun with {name.rpartition('info.')[2]} "
                    f"{was.get(name)!r}, not {given.get(name)!r}; give what it was begun with, or "
                    "start it anew with --overwrite"
                )


class _Line(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    frame: run_records.FrameRow  # as decided
    step: Step


class Checkpoints:
    """Keeps what a run needs to go on."""

    def __init__(
        self,
        run_folder: Path,
        every_s: float | None = None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        """`every_s` are seconds between checkpoints; `EVERY_S` if left out."""
        self.run_folder, self.folder = run_folder, run_folder / CHECKPOINT_NAME
        self._every_s, self._clock = EVERY_S if every_s is None else every_s, clock
        self._path = self.folder / FRAMES_NAME
        self._unwritten: list[bytes] = []
        self._start = self._num_done = self._num_kept = 0
        self._due = clock() + self._every_s

    def find(self) -> Header | None:
        """What the run that was not completed is made with; None if there is none.

        Raises:
          OutputError: If its file is damaged.
        """
        lines = self._read()
        if not lines:
            return None
        try:
            return decode_json(lines[0], Header, f"'{self._path}', line 1", refused=OutputError)
        except OutputError as error:
            raise OutputError(f"{error}; {_START_ANEW}") from error

    def begin(self, header: Header) -> None:
        """Starts with a new run; what an earlier one left is removed."""
        self.remove()
        files.make_folder(self.folder)
        files.replace_file(self._path, msgspec.json.encode(header) + b"\n")
        self._start = header.start

    def resume(
        self, header: Header, tracker: Tracker, trace: TraceArchive | None
    ) -> list[tuple[Tracks, Step]]:
        """Takes the tracker to where the last checkpoint was; gives the frames until then.

        Raises:
          RemindError: If the checkpoint is damaged.
        """
        self._start, memory = header.start, self.folder / MEMORY_NAME
        if memory.exists():
            tracker.load(memory)
            self._num_done = self._num_kept = int(tracker.state.frame) - self._start
        num, lines = self._num_done, self._read()
        if num > len(lines) - 1:
            raise OutputError(
                f"'{self._path}' has {len(lines) - 1} frames, the memory beside it has seen {num}; "
                f"{_START_ANEW}"
            )
        frames = [self._decode(number, lines[number]) for number in range(1, num + 1)]
        files.replace_file(self._path, b"".join(lines[: num + 1]))
        for path in sorted(self.folder.glob("trace-*.npz")):
            if int(path.stem.removeprefix("trace-")) >= num:
                path.unlink()
            elif trace is not None:
                trace.take_in(path)
        if frames:
            tracker.features.attention_slots = frames[-1][1].attention_slots
            tracker.identities.resume(
                {gone: kept for _, step in frames for gone, kept in step.merges}
            )
        return frames

    def add(self, decided: Tracks, step: Step) -> None:
        """Takes a frame that is done."""
        content = {"frame": run_records.tracks_to_json(decided), "step": step}
        self._unwritten.append(msgspec.json.encode(content) + b"\n")
        self._num_done += 1

    @property
    def is_due(self) -> bool:
        """Whether it is time for the next checkpoint."""
        return self._clock() >= self._due and self._num_done > self._num_kept

    def save(self, tracker: Tracker, trace: TraceArchive | None) -> None:
        """Makes a checkpoint of all frames so far, if the memory has seen these and no more."""
        begun = self._clock()
        state = tracker.state
        if self._num_done == self._num_kept or state is None:
            return
        if int(state.frame) - self._start != self._num_done:
            return  # Ctrl-C came between the step and its answers
        files.append_durably(self._path, b"".join(self._unwritten))
        self._unwritten.clear()
        if trace is not None:
            trace.save(self.folder / f"trace-{self._num_kept:08d}.npz", skip=self._num_kept)
        tracker.checkpoint(self.folder / MEMORY_NAME)
        self._num_kept = self._num_done
        took_s = self._clock() - begun
        self._due = self._clock() + max(self._every_s, took_s / MAX_OF_A_RUN)

    def remove(self) -> None:
        """Removes everything, once nothing is left to go on with."""
        with files.writing(self.folder), contextlib.suppress(FileNotFoundError):
            shutil.rmtree(self.folder)

    def _read(self) -> list[bytes]:
        """Header and frames, whole lines only; nothing if there is no such file."""
        if not self._path.is_file():
            return []
        lines = [line for _, line in read_lines(self._path, refused=OutputError)]
        return lines if not lines or lines[-1].endswith(b"\n") else lines[:-1]

    def _decode(self, number: int, line: bytes) -> tuple[Tracks, Step]:
        where = f"'{self._path}', line {number + 1}"
        try:
            row = decode_json(line, _Line, where, refused=OutputError)
            tracks = run_records.tracks_of(row.frame)
        except OutputError as error:
            raise OutputError(f"{where}: {error}; {_START_ANEW}") from error
        # As they are made: in other types pictures would be cut out a little differently.
        arrays = {name: vars(tracks)[name].astype("f4") for name in ("boxes", "detector_scores")}
        return dataclasses.replace(tracks, **arrays), row.step
