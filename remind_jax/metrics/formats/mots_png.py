"""MOTS PNG: pictures whose pixels are class times 1000 plus instance, in a folder or zip.

    SUBSET/instances/labels.txt      names of classes 1, 2, ..., one per line
    SUBSET/instances/000000.png      16 bits; class 10 is a region to be ignored, as in MOTS

The names may be missing: then classes are called by their numbers.
"""

from __future__ import annotations

import zipfile
from collections.abc import Callable
from pathlib import Path, PurePosixPath

import numpy as np

from remind_jax import files
from remind_jax.errors import SourceError
from remind_jax.files.records import MOST_LABEL
from remind_jax.masks.run_length import encode_label_map
from remind_jax.metrics.formats.rows import TrackRows, boxes_of
from remind_jax.sources.annotation_png import read_label_map
from remind_jax.sources.source import UnreadableFrame

FOLDER = "instances"
LABELS = "labels.txt"
IGNORED_CLASS = 10
_MOST_BYTES = 64 << 20  # of a picture
MOTS_PNG_INSTANCES = 1000  # of a class; a pixel is class times this, plus the instance
_MOST_CLASSES = (1 << 16) // MOTS_PNG_INSTANCES


def find_mots_png(path: Path, *, needs_labels: bool = True) -> str | None:
    """The folder of pictures at a path (`SUBSET/instances`); None if there is none.

    Args:
      path: Folder or zip.
      needs_labels: Whether only a folder with names of classes counts, as others may be anything;
        in a zip all do.
    """
    names = _names_in(path)
    needs_labels = needs_labels and path.is_dir()
    folders = {str(PurePosixPath(name).parent) for name in names if name.endswith(".png")}
    found = sorted(
        folder
        for folder in folders
        if PurePosixPath(folder).name == FOLDER
        and (not needs_labels or f"{folder}/{LABELS}" in names)
    )
    return found[0] if found else None


def read_mots_png(path: str | Path) -> TrackRows:
    """Reads one scene; the order of pictures by name is that of the frames.

    Raises:
      SourceError: If there are no pictures, or one cannot be read.
    """
    path = Path(path)
    folder = find_mots_png(path, needs_labels=False)
    if folder is None:
        raise SourceError(f"'{path}' holds no pictures in a folder '{FOLDER}'")
    read = _reader(path)
    names = sorted(
        name for name in _names_in(path)
        if name.endswith(".png") and str(PurePosixPath(name).parent) == folder
    )  # fmt: skip
    frame, track_id, rles, ignored_frame, ignored_rles = [], [], [], [], []
    size: tuple[int, int] | None = None
    for place, name in enumerate(names):
        try:
            numbers = read_label_map(read(name))
        except UnreadableFrame as error:
            raise SourceError(f"'{path}', {name}: {error}") from error
        shape = (numbers.shape[0], numbers.shape[1])
        if shape != (size := size or shape):
            raise SourceError(
                f"'{path}', {name} has {shape[1]}x{shape[0]} pixels and earlier ones "
                f"{size[1]}x{size[0]}; all must be of one size"
            )
        for number, rle in encode_label_map(numbers).items():
            if number // MOTS_PNG_INSTANCES == IGNORED_CLASS:
                ignored_frame.append(place)
                ignored_rles.append(rle)
            elif number >= MOTS_PNG_INSTANCES:
                frame.append(place)
                track_id.append(number)
                rles.append(rle)
    ids = np.asarray(track_id, np.int64)
    numbers, class_id = np.unique(ids // MOTS_PNG_INSTANCES, return_inverse=True)
    given = _read_labels(read, folder, _names_in(path), path)
    class_names = tuple(
        given[number - 1] if number <= len(given) else f"class {number}"
        for number in numbers.tolist()
    )
    return TrackRows(
        name=path.stem,
        num_frames=len(names),
        frame=np.asarray(frame, np.int64),
        track_id=ids,
        boxes=boxes_of(rles),
        class_id=class_id.astype(np.int64),
        class_names=class_names,
        rles=tuple(rles),
        frame_names=tuple(PurePosixPath(name).name for name in names),
        frame_size=size,
        ignored_frame=np.asarray(ignored_frame, np.int64),
        ignored_rles=tuple(ignored_rles),
    )


def _names_in(path: Path) -> list[str]:
    """Members of a zip, or files of folders called `instances`, with `/`.

    Raises:
      SourceError: If it cannot be read.
    """
    try:
        if path.is_dir():
            folders = [path / FOLDER, *(inner / FOLDER for inner in path.iterdir())]
            found = [file for folder in folders if folder.is_dir() for file in folder.iterdir()]
            return [file.relative_to(path).as_posix() for file in found if file.is_file()]
        if not zipfile.is_zipfile(path):
            return []
        with zipfile.ZipFile(path) as archive:
            return archive.namelist()
    except OSError as error:
        raise SourceError(f"'{path}' cannot be read: {error.strerror or error}") from error
    except (zipfile.BadZipFile, NotImplementedError, ValueError) as error:
        raise SourceError(f"'{path}' is a damaged zip: {error}; make it again") from error


def _reader(path: Path) -> Callable[[str], bytes]:
    """Reads a file of a folder, or a member of a zip."""

    def read(name: str) -> bytes:
        try:
            if path.is_dir():
                return files.read_bytes(path / name, _MOST_BYTES)
            with zipfile.ZipFile(path) as archive:
                if archive.getinfo(name).file_size > _MOST_BYTES:
                    raise SourceError(f"'{path}', {name} has over {_MOST_BYTES >> 20} MiB")
                return archive.read(name)
        except OSError as error:
            raise SourceError(f"cannot read '{path}', {name}: {error.strerror}") from error
        except (zipfile.BadZipFile, EOFError, NotImplementedError, RuntimeError) as error:
            raise SourceError(f"'{path}', {name} cannot be read: {error}") from error

    return read


def _read_labels(
    read: Callable[[str], bytes], folder: str, names: list[str], path: Path
) -> list[str]:
    name = f"{folder}/{LABELS}"
    if name not in names:
        return []
    try:
        labels = read(name).decode("utf-8-sig").splitlines()
    except UnicodeDecodeError as error:
        raise SourceError(f"'{path}', {name} is not text in UTF-8; save it as UTF-8") from error
    labels = [label.strip() for label in labels if label.strip()]
    if len(labels) > _MOST_CLASSES:
        raise SourceError(
            f"'{path}', {name} names {len(labels)} classes; at most {_MOST_CLASSES} fit into 16 "
            "bits, so leave the others out"
        )
    if long := [label for label in labels if len(label) > MOST_LABEL]:
        raise SourceError(
            f"'{path}', {name}: a name has {len(long[0])} characters; at most {MOST_LABEL}"
        )
    return labels
