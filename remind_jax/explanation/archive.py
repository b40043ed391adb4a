"""What every decision of a run was made of: records by frame, in memory and in `trace.npz`.

A column is named by the dotted path of its leaf and holds the rows of all frames one after another;
`shape.PATH` has the shape of the leaf in each frame. A checksum tells whether the file is as it was
written, so that its columns need no checks of their own.
"""

from __future__ import annotations

import dataclasses
import io
import typing
from collections.abc import Callable, Iterable, Mapping, Sequence, Sized
from pathlib import Path
from typing import Any, Generic, Self, TypeVar

import jax
import numpy as np

from remind_jax import files
from remind_jax.errors import OutputError
from remind_jax.files.tensors import checksum_of, read_npz
from remind_jax.method import named_leaves

TRACE_NAME = "trace.npz"
VERSION = 8  # of the file
_CHECKSUM = "sha256"

Record = TypeVar("Record", bound=Sized)


class TraceArchive(Generic[Record]):
    """Records of a run by frame; those of a file are read when they are first asked for."""

    def __init__(self, tracker: str, kind: type[Record], path: Path | None = None) -> None:
        """Makes an empty archive, or opens a file without reading it yet."""
        self._tracker, self._kind, self._path = tracker, kind, path
        self._frames: dict[int, Record] = {}
        self._labels: dict[int, str] = {}

    @property
    def labels(self) -> Mapping[int, str]:
        """Class name of every object that was known in some frame."""
        self._read()
        return self._labels

    def add(self, frame_index: int, record: Record, labels: Mapping[int, str]) -> None:
        """Keeps one frame."""
        self._frames[frame_index] = record
        self._labels = {**labels, **self._labels}

    def frame(self, frame_index: int) -> Record | None:
        """A frame's record, None without one. Raises OutputError if the file is damaged."""
        self._read()
        return self._frames.get(frame_index)

    def frames(self) -> list[tuple[int, Record]]:
        """Number and record of every frame in turn. Raises OutputError if the file is damaged."""
        self._read()
        return sorted(self._frames.items(), key=lambda frame: frame[0])

    def renumbered(self, number: Callable[[Iterable[int]], Mapping[int, int]]) -> Self:
        """The same records with other ids of objects."""
        self._read()
        ids = [
            np.ravel(leaf)
            for record in self._frames.values()
            for path, leaf in named_leaves(record)
            if _holds_objects(path)
        ]
        known = np.unique(np.concatenate([*ids, np.array(list(self._labels), np.int32)]))
        new = number(known.tolist())
        table = np.array([new[int(i)] for i in known], np.int32)

        def rename(path: Any, leaf: np.ndarray) -> np.ndarray:
            is_id = _holds_objects(jax.tree_util.keystr(path, simple=True, separator="."))
            return table[np.searchsorted(known, leaf)] if is_id else leaf

        other = type(self)(self._tracker, self._kind)
        other._frames = {
            index: jax.tree_util.tree_map_with_path(rename, record)
            for index, record in self._frames.items()
        }
        other._labels = {new[i]: label for i, label in self._labels.items()}
        return other

    def take_in(self, path: Path) -> None:
        """Adds the frames of a file. Raises OutputError if it is damaged, or of another method."""
        self._read()
        other = type(self)(self._tracker, self._kind, path)
        self._labels = {**other.labels, **self._labels}
        self._frames |= other._frames

    def save(self, path: Path, skip: int = 0) -> None:
        """Writes `trace.npz` at once or not at all, without the first `skip` frames."""
        self._read()
        index = sorted(self._frames)[skip:]
        records = [self._frames[i] for i in index]
        columns = {
            "tracker": np.array(self._tracker),
            "version": np.array(VERSION),
            "frame.index": np.array(index, np.int32),
            "frame.detections": np.array([len(record) for record in records], np.int32),
            "label.id": np.array(list(self._labels), np.int32),
            "label.name": np.array(list(self._labels.values()), np.str_),
        }
        for leaves in zip(*map(named_leaves, records), strict=True):
            name = leaves[0][0]
            columns[name], columns[f"shape.{name}"] = _join([leaf for _, leaf in leaves])
        columns[_CHECKSUM] = np.array(checksum_of({}, columns))
        buffer = io.BytesIO()
        np.savez_compressed(buffer, **columns)  # pyright: ignore[reportArgumentType]
        files.replace_file(path, buffer.getvalue())

    def _read(self) -> None:
        """Reads the file, if there is one that was not read yet."""
        if self._path is None:
            return
        path = self._path
        with files.reading(path, OutputError):
            columns = read_npz(path, refused=OutputError)
            again = "run the tracker again with --trace"
            version = int(columns["version"])
            if version != VERSION:
                raise OutputError(
                    f"'{path}' has version {version}, this remind-jax reads version {VERSION}; "
                    f"{again}"
                )
            if str(columns.pop(_CHECKSUM)) != checksum_of({}, columns):
                raise OutputError(f"'{path}' is damaged: its checksum is another one; {again}")
            tracker = str(columns["tracker"])
            if tracker != self._tracker:
                raise OutputError(
                    f"'{path}' is the trace of tracker '{tracker}', not '{self._tracker}' as the "
                    f"run says; {again}"
                )
            self._frames = _split(self._kind, columns)
            names = columns["label.id"].tolist(), columns["label.name"].tolist()
            self._labels = {int(i): str(name) for i, name in zip(*names, strict=True)}
        self._path = None


def first_rows(tree: Any, num: int) -> Any:
    """Without the padding behind the first rows; leaves without rows stay."""
    return jax.tree.map(lambda leaf: leaf[:num] if np.ndim(leaf) else leaf, tree)


def _holds_objects(path: str) -> bool:
    """Whether these are ids of objects; undecided tracks are numbered by themselves."""
    name = path.rpartition(".")[2]
    return (name == "id" or name.endswith("_id")) and name != "pending_id"


def _join(parts: Sequence[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """A leaf of all frames as one column, and its shape in each of them."""
    shapes = np.array([np.shape(part) for part in parts], np.int32)
    if not shapes.shape[1]:
        return np.stack(parts), shapes
    lacking = shapes[:, 1:].max(axis=0) - shapes[:, 1:]
    padded = [
        np.pad(part, [(0, 0), *((0, n) for n in more)])
        for part, more in zip(parts, lacking, strict=True)
    ]
    return np.concatenate(padded), shapes


def _split(kind: type[Record], columns: Mapping[str, np.ndarray]) -> dict[int, Record]:
    """The records by frame index."""
    leaves = {
        path: _cut(column, columns[f"shape.{path}"])
        for path, column in columns.items()
        if f"shape.{path}" in columns
    }
    return {
        number: _rebuild(kind, {path: parts[place] for path, parts in leaves.items()})
        for place, number in enumerate(columns["frame.index"].tolist())
    }


def _cut(column: np.ndarray, shapes: np.ndarray) -> list[np.ndarray]:
    """A leaf in each frame."""
    if not shapes.shape[1]:
        return list(column)
    parts = np.split(column, np.cumsum(shapes[:-1, 0]))
    return [
        part[(slice(None), *(slice(n) for n in shape[1:]))]
        for part, shape in zip(parts, shapes, strict=True)
    ]


def _rebuild(kind: type, leaves: Mapping[str, np.ndarray], path: str = "") -> Any:
    """Nested dataclasses from leaves by dotted path."""
    fields = typing.get_type_hints(kind)
    return kind(
        **{
            field.name: _rebuild(fields[field.name], leaves, f"{path}{field.name}.")
            if dataclasses.is_dataclass(fields[field.name])
            else leaves[path + field.name]
            for field in dataclasses.fields(kind)
        }
    )
