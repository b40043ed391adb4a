"""Folders of instance maps, one PNG per frame (DAVIS, ScanNet++, the masks of VOS trackers).

A pixel holds the id of its instance, 0 is background. In 8-bit truth 255 is void, as in DAVIS:
nothing is known there, so these pixels are cut out of predictions before anything is measured.
Classes come from the metadata that DAVIS folders may have (`id_to_label`, `instance_classes`; see
`sources.class_names`), if there is any.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from remind_jax import files
from remind_jax.errors import SourceError
from remind_jax.masks.run_length import encode_label_map
from remind_jax.metrics.formats.rows import UNKNOWN_CLASS, TrackRows, boxes_of
from remind_jax.sources.annotation_png import read_label_map
from remind_jax.sources.class_names import UNNAMED, ClassNames, parse_metadata
from remind_jax.sources.davis import metadata_files
from remind_jax.sources.file_tree import read_bytes
from remind_jax.sources.label_maps import require_classes
from remind_jax.sources.source import UnreadableFrame

VOID = 255


def find_map_scenes(path: Path) -> dict[str, Path]:
    """Folders of instance maps at most two levels below a path, by name of the scene.

    A folder `Annotations` is gone into first.
    """
    root = path / "Annotations" if (path / "Annotations").is_dir() else path
    if list_maps(root):
        return {path.name: root}
    found: list[Path] = []
    for outer in _folders_in(root):
        if list_maps(outer):
            found.append(outer)
        else:
            found += [inner for inner in _folders_in(outer) if list_maps(inner)]
    names = [folder.name for folder in found]
    if len(set(names)) == len(names):
        return dict(zip(names, found, strict=True))
    return {folder.relative_to(root).as_posix(): folder for folder in found}


def list_maps(folder: Path) -> list[Path]:
    """The PNG files of a folder, by name."""
    return sorted(path for path in folder.iterdir() if path.suffix.lower() == ".png")


def find_classes(folder: Path, name: str) -> ClassNames | None:
    """Class of each instance of a scene, from metadata in its folder or in those above it.

    The folder above `Annotations` is the last one looked into; without that, the one above the
    maps.

    Raises:
      SourceError: If a metadata file is damaged.
    """
    above = [folder, *folder.parents]
    roots = [i for i, place in enumerate(above[:4]) if (place / "Annotations").is_dir()]
    for place in above[: roots[0] + 1 if roots else 2]:
        for file in dict.fromkeys(Path(file).name for file in metadata_files(name)):
            path = place / file
            if path.is_file():
                classes = parse_metadata(read_bytes(path), str(path), name).classes
                if classes is not UNNAMED:
                    return classes
    return None


def read_label_maps(
    folder: Path, name: str, *, is_truth: bool, classes: ClassNames | None = None
) -> TrackRows:
    """Reads one scene, a map at a time; the order of files by name is that of the frames.

    In 8-bit maps of truth, 255 is void. An instance of class null is left out, as it is in a run.

    Raises:
      SourceError: If there is no map, one cannot be read, or an instance is not listed.
    """
    files = list_maps(folder)
    if not files:
        raise SourceError(f"'{folder}' holds no instance maps (.png)")
    frame, track_id, rles = [], [], []
    ignored_frame, ignored_rles = [], []
    size: tuple[int, int] | None = None
    for place, file in enumerate(files):
        labels = _read_map(file)
        size = size or (labels.shape[0], labels.shape[1])
        codes = encode_label_map(labels)
        if is_truth and labels.dtype == np.uint8 and VOID in codes:
            ignored_frame.append(place)
            ignored_rles.append(codes.pop(VOID))
        frame += [place] * len(codes)
        track_id += codes
        rles += codes.values()
    if classes is not None:
        require_classes(classes, track_id, str(folder))
    class_id, class_names = _name_instances(np.asarray(track_id, np.int64), classes)
    rows = TrackRows(
        name=name,
        num_frames=len(files),
        frame=np.asarray(frame, np.int64),
        track_id=np.asarray(track_id, np.int64),
        boxes=boxes_of(rles),
        class_id=class_id,
        class_names=class_names,
        rles=tuple(rles),
        frame_names=tuple(file.name for file in files),
        frame_size=size,
        ignored_frame=np.asarray(ignored_frame, np.int64),
        ignored_rles=tuple(ignored_rles),
        is_void=True,
    )
    return rows if classes is None else rows.select(class_id != UNKNOWN_CLASS)


def _name_instances(
    track_id: np.ndarray, classes: ClassNames | None
) -> tuple[np.ndarray, tuple[str, ...]]:
    if classes is None:
        return np.full(len(track_id), UNKNOWN_CLASS), ()
    labels = {number: classes[number] for number in np.unique(track_id).tolist()}
    names = sorted({label for label in labels.values() if label is not None})
    index = {n: UNKNOWN_CLASS if c is None else names.index(c) for n, c in labels.items()}
    return np.array([index[number] for number in track_id.tolist()], np.int64), tuple(names)


def _read_map(file: Path) -> np.ndarray:
    try:
        return read_label_map(files.read_bytes(file))
    except (OSError, UnreadableFrame) as error:
        why = getattr(error, "strerror", None) or str(error)
        raise SourceError(f"the instance map '{file}' cannot be used: {why}") from error


def _folders_in(path: Path) -> list[Path]:
    return sorted(inner for inner in path.iterdir() if inner.is_dir())
