"""Checkpoints of a run: the memory beside the journal, so that a killed run can be gone on with.

They lie in a folder of their own below that of the run, which is removed when the run is complete.
A checkpoint counts from the moment when its memory is in place: whatever the journal has beyond the
frames that this memory has seen is left out.
"""

from __future__ import annotations

import contextlib
import json
import shutil
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from remind_jax import files
from remind_jax.errors import OutputError
from remind_jax.explanation.archive import TraceArchive
from remind_jax.outputs.run_info import RunInfo
from remind_jax.outputs.writer import CHECKPOINT_NAME, MEMORY_NAME
from remind_jax.session.journal import JOURNAL_NAME, Journal, JournalWriter, Step
from remind_jax.session.live import Tracker

EVERY_S = 10.0  # seconds between checkpoints, or more where one is expensive:
MOST_OF_A_RUN = 0.01  # share of the time that they may take
_NOT_COMPARED = ("info.started_at",)


class Checkpoints:
    """Keeps what a run needs to be gone on with."""

    def __init__(
        self,
        run_folder: Path,
        every_s: float | None = None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        """Touches nothing yet.

        Args:
          run_folder: Folder of the run.
          every_s: Seconds between checkpoints; `EVERY_S` if left out.
          clock: Seconds, from any time on.
        """
        self.run_folder, self.folder = run_folder, run_folder / CHECKPOINT_NAME
        self._every_s, self._clock = EVERY_S if every_s is None else every_s, clock
        self._journal = JournalWriter(self.folder / JOURNAL_NAME)
        self._start = self._num_done = self._num_kept = 0
        self._due = clock() + self._every_s

    def find(self) -> Journal | None:
        """The journal of a run that was not completed; None if there is none.

        Raises:
          OutputError: If it is damaged.
        """
        return Journal.read(self.folder / JOURNAL_NAME)

    def begin(self, info: RunInfo, start: int, beside: Mapping[str, Any]) -> None:
        """Starts the journal of a new run; what an earlier one left is removed.

        Args:
          info: What the run is made with.
          start: Frames that the memory has seen before.
          beside: What else a run must have in common with one that it goes on with.

        Raises:
          OutputError: If it cannot be written.
        """
        self.remove()
        self._start = start
        files.make_folder(self.folder)
        self._journal = JournalWriter.begin(
            self.folder / JOURNAL_NAME, make_header(info, start, beside)
        )

    def go_on(self, tracker: Tracker, journal: Journal, trace: TraceArchive | None) -> list[Step]:
        """Takes the tracker to where the last checkpoint was; gives the frames until then.

        Args:
          tracker: As it was when the run began.
          journal: What `find` gave.
          trace: Gets the records of these frames; None if none are kept.

        Raises:
          RemindError: If the checkpoint is damaged.
        """
        num, memory = 0, self.folder / MEMORY_NAME
        self._start = journal.header["start"]
        if memory.exists():
            announced_before = tracker.identities.announcements
            tracker.load(memory)
            # What was announced since the beginning is found out again, frame by frame.
            tracker.identities.announcements = announced_before
            num = int(tracker.state.frame) - self._start
        steps = journal.steps(num)
        self._journal = journal.go_on(num)
        self._num_done = self._num_kept = num
        for path in sorted(self.folder.glob("trace-*.npz")):
            if int(path.stem.removeprefix("trace-")) >= num:
                path.unlink()
            elif trace is not None:
                trace.take_in(path)
        return steps

    def add(self, step: Step) -> None:
        """Takes a frame that is done."""
        self._journal.add(step)
        self._num_done += 1

    @property
    def is_due(self) -> bool:
        """Whether it is time for the next checkpoint."""
        return self._clock() >= self._due and self._num_done > self._num_kept

    def save(self, tracker: Tracker, trace: TraceArchive | None) -> None:
        """Makes a checkpoint of all frames so far, if the memory has seen these and no more.

        Args:
          tracker: After the last of them.
          trace: Records of all frames; None if none are kept.

        Raises:
          OutputError: If it cannot be written; the one before is kept.
        """
        begun = self._clock()
        state = tracker.state
        if self._num_done == self._num_kept or state is None:
            return
        if int(state.frame) - self._start != self._num_done:
            return  # Ctrl-C came between the step and its answers
        self._journal.flush()
        if trace is not None:
            trace.save(self.folder / f"trace-{self._num_kept:08d}.npz", skip=self._num_kept)
        tracker.save(self.folder / MEMORY_NAME, durably=True)
        self._num_kept = self._num_done
        took_s = self._clock() - begun
        self._due = self._clock() + max(self._every_s, took_s / MOST_OF_A_RUN)

    def remove(self) -> None:
        """Removes everything, once nothing is left to go on with.

        Raises:
          OutputError: If it cannot be removed.
        """
        with files.writing(self.folder), contextlib.suppress(FileNotFoundError):
            shutil.rmtree(self.folder)


def make_header(info: RunInfo, start: int, beside: Mapping[str, Any]) -> dict[str, Any]:
    """What a journal begins with, as `json` reads it back."""
    return json.loads(json.dumps({"info": info.to_json(), "start": start, "beside": dict(beside)}))


def check_same(before: Mapping[str, Any], now: Mapping[str, Any], folder: Path) -> None:
    """Makes sure that a run goes on with what it was begun with.

    Args:
      before: Header of its journal, or a part of it.
      now: What it is to go on with, in the same form.
      folder: Of the run.

    Raises:
      OutputError: If something differs; the sentence names the first thing that does.
    """
    was, given = _flatten(before), _flatten(now)
    for name in dict.fromkeys((*given, *was)):
        if name not in _NOT_COMPARED and was.get(name) != given.get(name):
            raise OutputError(
                f"the run in '{folder}' was begun with {name.partition('.')[2]} "
                f"{_say(was.get(name))}, not {_say(given.get(name))}; give what it was begun "
                "with, or start it anew with --overwrite"
            )


def _flatten(tree: Any, prefix: str = "") -> dict[str, Any]:
    """The values of nested dictionaries by dotted name; lists are values."""
    if not isinstance(tree, Mapping) or not tree:
        return {prefix.removesuffix("."): tree}
    found: dict[str, Any] = {}
    for name, value in tree.items():
        found |= _flatten(value, f"{prefix}{name}.")
    return found


def _say(value: Any) -> str:
    """A value in a sentence."""
    if value is None or value == {}:
        return "none"
    if isinstance(value, list):
        return ", ".join(map(str, value)) or "none"
    return f"'{value}'" if isinstance(value, str) else str(value)
