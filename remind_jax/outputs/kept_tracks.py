"""The frames of a run while it goes on: in memory, or on disk where it may go on for days."""

from __future__ import annotations

import pickle
import tempfile
import weakref
from collections.abc import Iterator
from pathlib import Path

from remind_jax.files import writing
from remind_jax.tracks import Tracks


class KeptTracks:
    """A list of frames that can be added to and gone through.

    On disk they are in a file without a name, which is gone with the process that wrote it, so that
    nothing but this object ever reads it.
    """

    def __init__(self, folder: Path | None = None) -> None:
        self._folder = folder
        self._frames: list[Tracks] = []
        self._num = 0
        self._file = None
        if folder is not None:
            with writing(folder):
                self._file = tempfile.TemporaryFile(dir=folder)  # noqa: SIM115
            weakref.finalize(self, self._file.close)

    def __len__(self) -> int:
        return self._num

    def append(self, tracks: Tracks) -> None:
        """Adds a frame. Raises OutputError if the disk is full."""
        self._num += 1
        if self._file is None or self._folder is None:
            self._frames.append(tracks)
            return
        with writing(self._folder):
            self._file.seek(0, 2)
            pickle.dump(tracks, self._file, pickle.HIGHEST_PROTOCOL)

    def __iter__(self) -> Iterator[Tracks]:
        if self._file is None:
            yield from self._frames
            return
        self._file.flush()
        place = 0
        for _ in range(self._num):
            self._file.seek(place)
            yield pickle.load(self._file)
            place = self._file.tell()
