"""Folders of instance maps, one PNG per frame: a pixel holds the id of its instance, 0 is nothing.

In 8-bit truth 255 is void: cut out of predictions before anything is measured.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path, PurePath

import cv2
import numpy as np

from remind_jax import files
from remind_jax.decision import NO_ID
from remind_jax.errors import OutputError, SourceError, UnreadableFrame
from remind_jax.formats.firm import firm_rows, masks_without_overlap
from remind_jax.formats.pictures import VOID, natural_key, read_label_map
from remind_jax.formats.rows import UNKNOWN_CLASS, TrackRows, boxes_of
from remind_jax.masks.run_length import decode_mask, encode_label_map
from remind_jax.printing.terminal import printable
from remind_jax.tracks import Tracks

METADATA_NAME = "metadata.json"


def find_map_scenes(path: Path) -> dict[str, Path]:
    """Folders of instance maps at most two levels below a path, by name of the scene.

    A folder `Annotations` is gone into first, here and one level below.
    """
    root = path / "Annotations" if (path / "Annotations").is_dir() else path
    if list_maps(root):
        return {path.name: root}
    found: list[tuple[str, Path]] = []
    for outer in _folders_in(root):
        inner = [outer] if list_maps(outer) else _folders_in(outer)
        scenes = [(folder.name, folder) for folder in inner if list_maps(folder)]
        if outer / "Annotations" in inner:
            scenes = [*find_map_scenes(outer).items()] or scenes
        found += scenes
    if len(dict(found)) == len(found):
        return dict(found)
    return {folder.relative_to(root).as_posix(): folder for _, folder in found}


def list_maps(folder: Path) -> list[Path]:
    """The PNG files of a folder, in natural order of their names."""
    maps = [path for path in folder.iterdir() if path.suffix.lower() == ".png"]
    return sorted(maps, key=lambda path: (natural_key(path.name), path.name))


def read_instance_maps(
    folder: Path, name: str, *, is_truth: bool, void: int | None = VOID
) -> TrackRows:
    """Reads one scene of DAVIS; the natural order of file names is that of the frames.

    Args:
      void: What is void in truth of 8 bits, unless no map holds anything else.

    Raises:
      SourceError: If there is no map, or one cannot be read.
    """
    maps = list_maps(folder)
    if not maps:
        raise SourceError(f"'{folder}' holds no instance maps (.png)")
    found, rles, ignored_frame, ignored_rles = [], [], [], []
    size: tuple[int, int] | None = None
    for place, file in enumerate(maps):
        try:
            with files.reading(file):
                labels = read_label_map(files.read_bytes(file))
        except UnreadableFrame as error:
            raise SourceError(f"'{file}': {error}") from error
        size = size or (labels.shape[0], labels.shape[1])
        for number, rle in encode_label_map(labels).items():
            if is_truth and labels.dtype == np.uint8 and number == void:
                ignored_frame.append(place)
                ignored_rles.append(rle)
            else:
                found.append((place, number))
                rles.append(rle)
    if ignored_rles and not found:
        return read_instance_maps(folder, name, is_truth=is_truth, void=None)
    frame, track_id = np.array(found, np.int64).reshape(-1, 2).T
    return TrackRows(
        name=name,
        num_frames=len(maps),
        frame=frame,
        track_id=track_id,
        boxes=boxes_of(rles),
        class_id=np.full(len(frame), UNKNOWN_CLASS),
        rles=tuple(rles),
        frame_names=tuple(file.name for file in maps),
        frame_size=size,
        ignored_frame=np.array(ignored_frame, np.int64),
        ignored_rles=tuple(ignored_rles),
        is_void=True,
    )


def _folders_in(path: Path) -> list[Path]:
    return sorted(inner for inner in path.iterdir() if inner.is_dir())


def write_instance_maps(run: Sequence[Tracks], name: str, folder: Path) -> None:
    """Writes the firm identities of a run; shared pixels go to the higher confidence.

    The maps come to be all at once, or none.

    Raises:
      OutputError: If an identity is beyond 16 bits, something else lies where the maps go, or the
        folder cannot be written.
    """
    name = PurePath(printable(name)).name or "run"
    maps = folder / "Annotations" / name
    classes = {
        int(tracks.object_id[row]) + 1: printable(tracks.labels[row])
        for tracks in run
        for row in np.flatnonzero(tracks.object_id != NO_ID)
    }
    most = max(classes, default=0)
    if most > np.iinfo(np.uint16).max:
        raise OutputError(
            f"identity {most - 1} does not fit into instance maps of 16 bits; write CVAT instead "
            "(--out truth.xml)"
        )
    pictures = [f"{picture}.png" for picture in picture_names(run)]
    others = {path.name for path in maps.iterdir()} - set(pictures) if maps.is_dir() else set()
    if others:
        raise OutputError(
            f"'{maps}' holds '{min(others)}', which is no map of this run; name another folder"
        )
    dtype = np.uint8 if most <= VOID - 1 else np.uint16
    with files.replacing_folder(maps, folder) as unfinished:
        for tracks, picture in zip(run, pictures, strict=True):
            (unfinished / picture).write_bytes(_draw(tracks, dtype))
        content = {
            "sequence": name,
            "id_to_class": {str(k): v for k, v in sorted(classes.items())},
            "frame_numbers": [tracks.source_index for tracks in run],
        }
        text = json.dumps(content, ensure_ascii=False, indent=1) + "\n"
        files.replace_file(folder / METADATA_NAME, text.encode("utf-8"))


def _draw(tracks: Tracks, dtype: type[np.unsignedinteger]) -> bytes:
    """The map of a frame as a PNG."""
    drawn = np.zeros(tracks.frame_size, dtype)
    rows = firm_rows(tracks)
    for row, rle in zip(rows, masks_without_overlap(tracks, rows), strict=True):
        if rle is not None:
            drawn[decode_mask(rle).astype(bool)] = int(tracks.object_id[row]) + 1
    return cv2.imencode(".png", drawn)[1].tobytes()


def picture_names(run: Sequence[Tracks]) -> list[str]:
    """Names of pictures without suffix, that sort as the frames do: those of the source if so.

    In natural order, as they are read here, and by their letters, as others read them.
    """
    names = [printable(PurePath(tracks.name).stem) for tracks in run]
    if sorted(set(names)) == names == sorted(names, key=natural_key):
        return names
    return [f"{tracks.source_index:06d}" for tracks in run]
