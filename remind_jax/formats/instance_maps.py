"""Folders of instance maps, one PNG per frame: DAVIS, masks of VOS trackers, MOTS PNG.

In DAVIS a pixel holds the id of its instance, 0 is background. In 8-bit truth 255 is void: nothing
is known there, so these pixels are cut out of predictions before anything is measured.

In MOTS PNG, a folder or a zip, a pixel is class times 1000 plus instance; class 10 is a region to
be ignored. Without names, classes are called by their numbers:

    SUBSET/instances/labels.txt      names of classes 1, 2, ..., one per line
    SUBSET/instances/000000.png      16 bits
"""

from __future__ import annotations

import dataclasses
import zipfile
from collections.abc import Callable, Sequence
from pathlib import Path, PurePosixPath

import numpy as np

from remind_jax import files
from remind_jax.errors import SourceError, UnreadableFrame
from remind_jax.files.limits import MAX_FILE_BYTES, MAX_LABEL
from remind_jax.formats.pictures import read_label_map
from remind_jax.formats.rows import UNKNOWN_CLASS, TrackRows, boxes_of
from remind_jax.masks.run_length import encode_label_map

VOID = 255
MOTS_INSTANCES = 1000  # of a class in MOTS PNG
MOTS_IGNORED_CLASS = 10
MOTS_FOLDER, MOTS_LABELS = "instances", "labels.txt"


def find_map_scenes(path: Path) -> dict[str, Path]:
    """Folders of instance maps at most two levels below a path, by name of the scene.

    A folder `Annotations` is gone into first.
    """
    root = path / "Annotations" if (path / "Annotations").is_dir() else path
    if list_maps(root):
        return {path.name: root}
    found: list[Path] = []
    for outer in _folders_in(root):
        found += [f for f in ([outer] if list_maps(outer) else _folders_in(outer)) if list_maps(f)]
    names = [folder.name for folder in found]
    if len(set(names)) == len(names):
        return dict(zip(names, found, strict=True))
    return {folder.relative_to(root).as_posix(): folder for folder in found}


def list_maps(folder: Path) -> list[Path]:
    """The PNG files of a folder, by name."""
    return sorted(path for path in folder.iterdir() if path.suffix.lower() == ".png")


def read_instance_maps(folder: Path, name: str, *, is_truth: bool) -> TrackRows:
    """Reads one scene of DAVIS; the order of files by name is that of the frames.

    Raises:
      SourceError: If there is no map, or one cannot be read.
    """
    maps = list_maps(folder)
    if not maps:
        raise SourceError(f"'{folder}' holds no instance maps (.png)")

    def is_void(number: int, labels: np.ndarray) -> bool:
        return is_truth and labels.dtype == np.uint8 and number == VOID

    names = [file.name for file in maps]
    rows = _read_maps(
        name, names, lambda name: files.read_bytes(folder / name), is_void, str(folder)
    )
    return dataclasses.replace(rows, class_id=np.full(len(rows), UNKNOWN_CLASS), is_void=True)


def find_mots_png(path: Path, *, needs_labels: bool = True) -> str | None:
    """The folder of pictures of MOTS PNG at a path (`SUBSET/instances`); None if there is none.

    Args:
      needs_labels: Whether only a folder with names of classes counts, as others may be anything;
        in a zip all do.
    """
    names = _names_in(path)
    needs_labels = needs_labels and path.is_dir()
    folders = {str(PurePosixPath(name).parent) for name in names if name.endswith(".png")}
    found = (
        folder
        for folder in sorted(folders)
        if PurePosixPath(folder).name == MOTS_FOLDER
        and (not needs_labels or f"{folder}/{MOTS_LABELS}" in names)
    )
    return next(found, None)


def read_mots_png(path: str | Path) -> TrackRows:
    """Reads one scene of MOTS PNG; the order of pictures by name is that of the frames.

    Raises:
      SourceError: If there are no pictures, or one cannot be read.
    """
    path = Path(path)
    folder, members = find_mots_png(path, needs_labels=False), _names_in(path)
    if folder is None:
        raise SourceError(f"'{path}' holds no pictures in a folder '{MOTS_FOLDER}'")
    names = sorted(
        name
        for name in members
        if name.endswith(".png") and str(PurePosixPath(name).parent) == folder
    )

    def is_ignored(number: int, labels: np.ndarray) -> bool:
        return number // MOTS_INSTANCES == MOTS_IGNORED_CLASS

    rows = _read_maps(
        path.stem, names, lambda name: _read_member(path, name), is_ignored, str(path)
    )
    rows = rows.select(rows.track_id >= MOTS_INSTANCES)
    numbers, class_id = np.unique(rows.track_id // MOTS_INSTANCES, return_inverse=True)
    given: list[str] = []
    if (labels := f"{folder}/{MOTS_LABELS}") in members:
        with files.reading(path, place=labels):
            lines = _read_member(path, labels).decode("utf-8-sig").splitlines()
        given = [line.strip() for line in lines if line.strip()]
        if max(map(len, given), default=0) > MAX_LABEL:
            raise SourceError(f"'{path}', {labels}: a name has over {MAX_LABEL} characters")
    class_names = tuple(
        given[number - 1] if number <= len(given) else f"class {number}"
        for number in numbers.tolist()
    )
    return dataclasses.replace(rows, class_id=class_id.astype(np.int64), class_names=class_names)


def _read_maps(
    name: str,
    maps: Sequence[str],
    read: Callable[[str], bytes],
    is_ignored: Callable[[int, np.ndarray], bool],
    where: str,
) -> TrackRows:
    """The instances of maps, each by its number; regions to be ignored apart from the rest."""
    found, rles, ignored_frame, ignored_rles = [], [], [], []
    size: tuple[int, int] | None = None
    for place, file in enumerate(maps):
        try:
            with files.reading(where, place=file):
                labels = read_label_map(read(file))
        except UnreadableFrame as error:
            raise SourceError(f"'{where}', {file}: {error}") from error
        size = size or (labels.shape[0], labels.shape[1])
        if labels.shape != size:
            raise SourceError(
                f"'{where}', {file} has {labels.shape[1]}x{labels.shape[0]} pixels, not "
                f"{size[1]}x{size[0]}; all must be of one size"
            )
        for number, rle in encode_label_map(labels).items():
            if is_ignored(number, labels):
                ignored_frame.append(place)
                ignored_rles.append(rle)
            else:
                found.append((place, number))
                rles.append(rle)
    frame, track_id = np.array(found, np.int64).reshape(-1, 2).T
    return TrackRows(
        name=name,
        num_frames=len(maps),
        frame=frame,
        track_id=track_id,
        boxes=boxes_of(rles),
        class_id=np.full(len(frame), UNKNOWN_CLASS),
        rles=tuple(rles),
        frame_names=tuple(PurePosixPath(file).name for file in maps),
        frame_size=size,
        ignored_frame=np.array(ignored_frame, np.int64),
        ignored_rles=tuple(ignored_rles),
    )


def _names_in(path: Path) -> list[str]:
    """Members of a zip, or files of folders called `instances`, with `/`."""
    with files.reading(path):
        if path.is_dir():
            folders = [path / MOTS_FOLDER, *(inner / MOTS_FOLDER for inner in path.iterdir())]
            found = [file for folder in folders if folder.is_dir() for file in folder.iterdir()]
            return [file.relative_to(path).as_posix() for file in found if file.is_file()]
        if not zipfile.is_zipfile(path):
            return []
        with zipfile.ZipFile(path) as archive:
            return archive.namelist()


def _read_member(path: Path, name: str) -> bytes:
    """A file of a folder, or a member of a zip."""
    if path.is_dir():
        return files.read_bytes(path / name)
    with zipfile.ZipFile(path) as archive:
        if archive.getinfo(name).file_size > MAX_FILE_BYTES:
            raise SourceError(f"'{path}', {name} has over {MAX_FILE_BYTES >> 20} MiB")
        return archive.read(name)


def _folders_in(path: Path) -> list[Path]:
    return sorted(inner for inner in path.iterdir() if inner.is_dir())
