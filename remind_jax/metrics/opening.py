"""Recognizes tracks at a path and opens them scene by scene.

| format | what lies there |
| --- | --- |
| `mot` | MOTChallenge text: a file, a folder of files, or `<scene>/gt/gt.txt` |
| `mots`, `kitti-mots` | MOTS text: likewise |
| `davis` | instance maps, one PNG per frame: a folder, or folders of them |
| `coco-video` | COCO-video / YouTube-VIS JSON, truth or list of results |
| `cvat` | XML of CVAT for video, or the zip that holds it |
| `run` | output folder of `remind run`, or a folder of such folders |
"""

from __future__ import annotations

import dataclasses
import functools
import zipfile
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Literal, get_args

import numpy as np

from remind_jax import files
from remind_jax.errors import SourceError
from remind_jax.formats.coco import read_data_set
from remind_jax.formats.coco_tracks import CocoIndex, group_by_video, index_videos, read_video
from remind_jax.formats.cvat import NAME_IN_ZIP, looks_like_cvat, read_cvat, scene_name
from remind_jax.formats.instance_maps import find_map_scenes, read_instance_maps
from remind_jax.formats.mot import FileFormat, read_text_rows, recognize_format
from remind_jax.formats.pictures import VOID
from remind_jax.formats.rows import UNKNOWN_CLASS, TrackRows
from remind_jax.metrics.run_folder import holds_run, read_run_rows
from remind_jax.sources.class_names import UNNAMED, ClassNames, find_metadata
from remind_jax.sources.davis import metadata_files
from remind_jax.sources.file_tree import read_bytes
from remind_jax.sources.label_maps import require_classes

Format = Literal["mot", "mots", "kitti-mots", "davis", "coco-video", "cvat", "run"]
FORMATS: tuple[str, ...] = get_args(Format)
TEXT_FORMATS: tuple[FileFormat, ...] = ("mot", "mots", "kitti-mots")


@dataclasses.dataclass(frozen=True)
class SceneSet:
    """Scenes at a path; each is read when it is asked for."""

    path: Path
    format: Format
    files: Mapping[str, Path]  # where each scene lies, by its name
    read_one: Callable[[Path, str], TrackRows]
    index: CocoIndex = dataclasses.field(default_factory=CocoIndex)  # for lists of results

    def read(self, name: str) -> TrackRows:
        """One of the scenes. Raises SourceError if it cannot be read."""
        return self.read_one(self.files[name], name)


def open_scenes(
    path: str | Path,
    format: Format | None = None,
    *,
    truth: SceneSet | None = None,
    like: FileFormat | None = None,
) -> SceneSet:
    """Opens truth, or predictions of a truth: lists of results need its videos and images.

    Raises:
      SourceError: If nothing is there, it is not recognized, or it cannot be read.
    """
    path = files.as_path(path, "what is to be scored", SourceError)
    if not path.exists():
        raise SourceError(f"{path} cannot be read: No such file or directory")
    with files.reading(path):
        files.check_regular(path)
    if path.is_dir():
        with files.reading(path):
            return _open_folder(path, format, is_truth=truth is None)
    if format == "cvat" or (format is None and looks_like_cvat(path)):
        return SceneSet(path, "cvat", {scene_name(path): path}, lambda file, _: read_cvat(file))
    if format is None and zipfile.is_zipfile(path):
        raise SourceError(f"'{path}' is a zip that holds no '{NAME_IN_ZIP}' of CVAT; unpack it")
    if path.suffix.lower() == ".json" or format == "coco-video":
        return _open_json(path, truth)
    if format in ("davis", "run"):
        raise SourceError(f"{path} is a file; format '{format}' is a folder")
    if format is None and path.suffix in (".csv", ".jsonl") and holds_run(path.parent):
        raise SourceError(f"'{path}' is a part of a run; give the folder '{path.parent}'")
    found = format or recognize_format(path)
    if format is None and like is not None and is_blank(path):
        found = like
    read = functools.partial(read_text_rows, format=found, is_truth=truth is None)
    return SceneSet(path, found, {path.stem: path}, read)


def _open_folder(path: Path, format: Format | None, *, is_truth: bool) -> SceneSet:
    runs = _find_runs(path)
    if runs and format in (None, "run"):
        return SceneSet(path, "run", runs, read_run_rows)
    texts = _find_texts(path)
    if texts and (format in TEXT_FORMATS or format is None):
        found = format or recognize_format(*texts.values())
        read = functools.partial(read_text_rows, format=found, is_truth=is_truth)
        return SceneSet(path, found, texts, read)
    maps = find_map_scenes(path)
    if maps and format in (None, "davis"):
        return SceneSet(path, "davis", maps, functools.partial(_read_maps, is_truth=is_truth))
    exports = {file.stem: file for file in sorted(path.glob("*.xml")) if looks_like_cvat(file)}
    if exports and format in (None, "cvat"):
        return SceneSet(path, "cvat", exports, lambda file, _: read_cvat(file))
    looked_for = f"tracks in format '{format}'" if format else "tracks in a known format"
    raise SourceError(
        f"'{path}' holds no {looked_for}; give a folder of instance maps (.png), of MOT or MOTS "
        "text (.txt), of CVAT files (.xml), a run of remind, or a JSON file"
    )


def _find_runs(path: Path) -> dict[str, Path]:
    if holds_run(path):
        return {path.name: path}
    return {inner.name: inner for inner in sorted(path.iterdir()) if holds_run(inner)}


def _find_texts(path: Path) -> dict[str, Path]:
    """Text files by scene: `<scene>/gt/gt.txt`, `gt/gt.txt`, or `<scene>.txt`."""
    if (path / "gt" / "gt.txt").is_file():
        return {path.name: path / "gt" / "gt.txt"}
    inner = {f.name: f / "gt" / "gt.txt" for f in sorted(path.iterdir())}
    inner = {name: file for name, file in inner.items() if file.is_file()}
    if inner:
        return inner
    hidden = ("seqmap", "readme", "license")
    files = sorted(path.glob("*.txt"))
    return {f.stem: f for f in files if not f.stem.lower().startswith(hidden)}


def _read_maps(folder: Path, name: str, is_truth: bool) -> TrackRows:
    """Instance maps; an instance of class null is left out of truth, as it is of a run."""
    classes = find_classes(folder, name)
    void = None if classes is not None and VOID in classes.by_id else VOID
    rows = read_instance_maps(folder, name, is_truth=is_truth, void=void)
    if classes is not None and len(classes.frame_numbers) == rows.num_frames:
        rows = dataclasses.replace(rows, source_frames=np.array(classes.frame_numbers))
    if classes is None or not is_truth:
        return rows
    ids = np.unique(rows.track_id).tolist()
    require_classes(classes, ids, str(folder))
    names = sorted({label for i in ids if (label := classes[i]) is not None})
    index = {i: UNKNOWN_CLASS if classes[i] is None else names.index(str(classes[i])) for i in ids}
    class_id = np.array([index[number] for number in rows.track_id.tolist()], np.int64)
    named = dataclasses.replace(rows, class_id=class_id, class_names=tuple(names))
    return named.select(class_id != UNKNOWN_CLASS)


def find_classes(folder: Path, name: str) -> ClassNames | None:
    """Class of each instance of a scene of instance maps, from metadata there or in folders above.

    The folder above `Annotations` is the last one looked into; without that, the one above the
    maps.

    Raises:
      SourceError: If a metadata file is damaged.
    """
    above = [folder, *folder.parents]
    names = [*dict.fromkeys(Path(file).name for file in metadata_files(name))]
    roots = [i for i, place in enumerate(above[:4]) if (place / "Annotations").is_dir()]
    for place in above[: roots[0] + 1 if roots else 2]:
        classes = find_metadata(place, names, name).classes
        if classes is not UNNAMED:
            return classes
    return None


def _open_json(path: Path, truth: SceneSet | None) -> SceneSet:
    file = str(path)
    content = read_data_set(read_bytes(path), file)
    if content.videos or truth is None:
        index = index_videos(content, file)
    else:
        index = truth.index
    if not index.videos:
        raise SourceError(
            f"'{path}' names no `videos`: it is no truth, and a list of results names them by "
            "number only; give truth in the JSON of the same data set"
        )
    groups = group_by_video(content, file)
    unknown = next((number for number in groups if number not in index.videos), None)
    if unknown is not None and groups.keys() & index.videos.keys():
        raise SourceError(
            f"'{path}', row {groups[unknown][0][0]} is of video {unknown!r}, which is not among "
            "the `videos`; give the id of one of these"
        )
    if groups and not groups.keys() & index.videos.keys():
        raise SourceError(
            f"'{path}' has rows of video {next(iter(groups))!r} and the like, and none of a video "
            f"that is named ({next(iter(index.videos))!r}, ...); give the ids of the data set"
        )
    numbers = {video.name: number for number, video in index.videos.items()}

    def read(_: Path, name: str) -> TrackRows:
        return read_video(groups.get(numbers[name], []), index, numbers[name], file)

    return SceneSet(path, "coco-video", dict.fromkeys(numbers, path), read, index)


def is_blank(path: Path) -> bool:
    """Whether a text file holds nothing. Raises SourceError if it cannot be read."""
    return not read_bytes(path).strip()
