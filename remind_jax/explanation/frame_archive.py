"""What every method keeps of a run with a trace: records by frame, in memory and in `trace.npz`."""

from __future__ import annotations

import abc
import io
import zipfile
from collections.abc import Callable, Iterable, Mapping, Sized
from pathlib import Path
from typing import Generic, Self, TypeVar

import numpy as np

from remind_jax import files
from remind_jax.errors import OutputError
from remind_jax.method import PAPER_METHOD

Columns = dict[str, np.ndarray]
Record = TypeVar("Record", bound=Sized)


class FrameArchive(abc.ABC, Generic[Record]):
    """Records of a run by frame; those of a file are read when they are first asked for.

    In the file every array holds the rows of all frames one after another; `frame.index` numbers
    the frames and `frame.detections` tells how many detections belong to each.
    """

    TRACKER = PAPER_METHOD  # the method that makes such records
    VERSION = 1  # of the file

    def __init__(self) -> None:
        self._frames: dict[int, Record] = {}
        self._path: Path | None = None

    @classmethod
    def open(cls, path: Path) -> Self:
        """The archive of a file, not read yet."""
        archive = cls()
        archive._path = path
        return archive

    def frame(self, frame_index: int) -> Record | None:
        """The record of a frame; None if the run has no such frame.

        Raises:
          OutputError: If the file is damaged.
        """
        self._read()
        return self._frames.get(frame_index)

    def renumbered(self, number: Callable[[Iterable[int]], Mapping[int, int]]) -> Self:
        """The same records with other ids of objects.

        Args:
          number: Gives the new id of each of some ids.
        """
        columns = self._join_frames()
        ids = {name: column for name, column in columns.items() if _holds_objects(name)}
        known = np.unique(np.concatenate([column.ravel() for column in ids.values()]))
        new = number(known.tolist())
        table = np.array([new[int(i)] for i in known], np.int32)
        changed = {name: table[np.searchsorted(known, column)] for name, column in ids.items()}
        other = type(self)()
        other._frames = other._from_columns(columns | changed)
        return other

    def save(self, path: Path) -> None:
        """Writes `trace.npz` at once or not at all.

        Raises:
          OutputError: If it cannot be written.
        """
        columns = {
            "tracker": np.array(self.TRACKER),
            "version": np.array(self.VERSION),
            **self._join_frames(),
        }
        buffer = io.BytesIO()
        np.savez_compressed(buffer, **columns)  # pyright: ignore[reportArgumentType]
        files.replace_file(path, buffer.getvalue())

    def _join_frames(self) -> Columns:
        self._read()
        index = sorted(self._frames)
        frames = [self._frames[i] for i in index]
        return {
            "frame.index": np.array(index, np.int32),
            "frame.detections": np.array([len(frame) for frame in frames], np.int32),
            **self._to_columns(frames),
        }

    @abc.abstractmethod
    def _to_columns(self, frames: list[Record]) -> Columns:
        """What the frames hold, by name."""

    @abc.abstractmethod
    def _from_columns(self, columns: Mapping[str, np.ndarray]) -> dict[int, Record]:
        """The records by frame index."""

    def _read(self) -> None:
        if self._path is None:
            return
        path = self._path
        try:
            with np.load(path) as file:
                # Traces of the default method did not always name it.
                tracker = str(file["tracker"]) if "tracker" in file else PAPER_METHOD
                if tracker != self.TRACKER:
                    raise OutputError(
                        f"'{path}' is the trace of tracker '{tracker}', not '{self.TRACKER}' as "
                        "the run says; run the tracker again with --trace"
                    )
                if file["version"] > self.VERSION:
                    raise OutputError(
                        f"'{path}' has version {file['version']}, this remind-jax reads up to "
                        f"{self.VERSION}; upgrade remind-jax"
                    )
                columns = {name: file[name] for name in file.files}
            self._frames = self._from_columns(columns)
        except OutputError:
            raise
        except (OSError, ValueError, KeyError, zipfile.BadZipFile) as error:
            raise OutputError(
                f"'{path}' is damaged ({type(error).__name__}: {error}); run the tracker again "
                "with --trace"
            ) from error
        self._path = None


def _holds_objects(column: str) -> bool:
    """Whether these are ids of objects; undecided tracks are numbered by themselves."""
    name = column.rpartition(".")[2]
    return (name == "id" or name.endswith("_id")) and name != "pending_id"
