"""Recognizes tracks at a path and opens them scene by scene.

| format | what lies there |
| --- | --- |
| `mot` | MOTChallenge text: a file, a folder of files, or `<scene>/gt/gt.txt` |
| `mots`, `kitti-mots` | MOTS text: likewise |
| `davis` | instance maps, one PNG per frame: a folder, or folders of them |
| `coco-video` | COCO-video / YouTube-VIS JSON, truth or list of results |
| `tao` | TAO or CocoVID JSON, truth or list of results |
| `burst` | BURST JSON |
| `cvat` | XML of CVAT for video, or the zip that holds it |
| `mots-png` | MOTS PNG: a zip or folder with `instances/*.png` of 16 bits |
| `run` | output folder of `remind run`, or a folder of such folders |
"""

from __future__ import annotations

import dataclasses
import functools
import zipfile
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Literal, get_args

from remind_jax import files
from remind_jax.errors import SourceError
from remind_jax.files.records import read_json
from remind_jax.metrics.formats.cvat import NAME_IN_ZIP, looks_like_cvat, read_cvat
from remind_jax.metrics.formats.json_index import JsonIndex, index_json
from remind_jax.metrics.formats.json_records import Content, Entry, TrackFile
from remind_jax.metrics.formats.json_tracks import group_by_video, index_burst, read_video
from remind_jax.metrics.formats.label_maps import find_classes, find_map_scenes, read_label_maps
from remind_jax.metrics.formats.mots_png import find_mots_png, read_mots_png
from remind_jax.metrics.formats.rows import TrackRows
from remind_jax.metrics.formats.run_folder import holds_run, read_run_rows
from remind_jax.metrics.formats.text import FileFormat, read_text_rows, recognize_format

Format = Literal[
    "mot", "mots", "kitti-mots", "davis", "coco-video", "tao", "burst", "cvat", "mots-png", "run"
]
FORMATS: tuple[str, ...] = get_args(Format)
TEXT_FORMATS: tuple[FileFormat, ...] = ("mot", "mots", "kitti-mots")


@dataclasses.dataclass(frozen=True)
class SceneSet:
    """Scenes at a path; each is read when it is asked for."""

    path: Path
    format: Format
    read: Mapping[str, Callable[[], TrackRows]]  # by name of the scene
    files: Mapping[str, Path]  # where each scene lies
    index: JsonIndex = dataclasses.field(
        default_factory=JsonIndex
    )  # of JSON truth, for lists of results

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the scenes."""
        return tuple(self.read)


def open_scenes(
    path: str | Path,
    format: Format | None = None,
    *,
    truth: SceneSet | None = None,
    like: FileFormat | None = None,
) -> SceneSet:
    """Opens truth (`truth` left out) or predictions (`truth` given).

    Args:
      path: File or folder.
      format: What it is; recognized if left out.
      truth: The truth that predictions belong to: lists of results need its videos and images.
      like: Format of a text file that has no row to recognize it by.

    Raises:
      SourceError: If nothing is there, it is not recognized, or it cannot be read.
    """
    path = files.as_path(path, "what is to be scored", SourceError)
    if not path.exists():
        raise SourceError(f"{path} cannot be read: No such file or directory")
    try:
        files.check_regular(path)
    except OSError as error:
        raise SourceError(f"{path} cannot be read: {error.strerror}") from error
    if format == "mots-png" or (format is None and find_mots_png(path) is not None):
        return SceneSet(
            path, "mots-png", {path.stem: functools.partial(read_mots_png, path)}, {path.stem: path}
        )
    if path.is_dir():
        try:
            return _open_folder(path, format, is_truth=truth is None)
        except OSError as error:
            raise SourceError(f"{path} cannot be read: {error.strerror}") from error
    if format == "cvat" or (format is None and looks_like_cvat(path)):
        name = path.parent.name if path.name == NAME_IN_ZIP else path.stem
        return SceneSet(path, "cvat", {name: functools.partial(read_cvat, path)}, {name: path})
    if format is None and zipfile.is_zipfile(path):
        raise SourceError(
            f"'{path}' is a zip that holds neither '{NAME_IN_ZIP}' of CVAT nor MOTS PNG "
            "('instances/*.png'); pack one of these, or unpack it"
        )
    if path.suffix.lower() == ".json" or format in ("coco-video", "tao", "burst"):
        return _open_json(path, format, truth)
    if format in ("davis", "run"):
        raise SourceError(f"{path} is a file; format '{format}' is a folder")
    found = format or recognize_format(path)
    if format is None and like is not None and is_blank(path):
        found = like
    return _text_scenes(path, {path.stem: path}, found, is_truth=truth is None)


def holds_text(path: Path) -> bool:
    """Whether a path is a text file or a folder of such."""
    if path.is_dir():
        return not _find_runs(path) and bool(_find_texts(path))
    return path.suffix.lower() not in (".json", ".xml", ".zip")


def _open_folder(path: Path, format: Format | None, *, is_truth: bool) -> SceneSet:
    runs = _find_runs(path)
    if runs and format in (None, "run"):
        read = {
            name: functools.partial(read_run_rows, folder, name) for name, folder in runs.items()
        }
        return SceneSet(path, "run", read, runs)
    texts = _find_texts(path)
    if texts and (format in TEXT_FORMATS or format is None):
        found = format or recognize_format(*texts.values())
        return _text_scenes(path, texts, found, is_truth=is_truth)
    maps = find_map_scenes(path)
    if maps and format in (None, "davis"):
        read = {
            name: functools.partial(_read_maps, name, folder, is_truth)
            for name, folder in maps.items()
        }
        return SceneSet(path, "davis", read, maps)
    looked_for = f"tracks in format '{format}'" if format else "tracks in a known format"
    raise SourceError(
        f"'{path}' holds no {looked_for}; give a folder of instance maps (.png), of MOT or MOTS "
        "text (.txt), a run of remind, or a JSON file"
    )


def _text_scenes(path: Path, files: dict[str, Path], format: Any, *, is_truth: bool) -> SceneSet:
    read = {
        name: functools.partial(read_text_rows, file, name, format, is_truth=is_truth)
        for name, file in files.items()
    }
    return SceneSet(path, format, read, files)


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


def _read_maps(name: str, folder: Path, is_truth: bool) -> TrackRows:
    return read_label_maps(
        folder, name, is_truth=is_truth, classes=find_classes(folder, name) if is_truth else None
    )


def _open_json(path: Path, format: Format | None, truth: SceneSet | None) -> SceneSet:
    content: Content = read_json(path, Content)  # pyright: ignore[reportArgumentType]
    found = format or _recognize_json(path, content, truth)
    if isinstance(content, list):
        if found == "burst" or truth is None or not truth.index.videos:
            raise SourceError(
                f"{path} is a list of results, which names videos by number only; give truth in "
                "the JSON of the same data set"
            )
        index = truth.index
    elif found == "burst":
        _require(content.sequences, "sequences", path, found)
        index = index_burst(content)
    else:
        _require(content.videos, "videos", path, found)
        index = index_json(content)
    return _json_scenes(path, content, found, index)


def _require(part: Any, name: str, path: Path, format: Format) -> None:
    if part is None:
        raise SourceError(f"{path} is not {format} JSON: `{name}` is missing; add it")


def _json_scenes(path: Path, content: Content, format: Any, index: JsonIndex) -> SceneSet:
    groups = group_by_video(content, format, index)
    read = {
        video.name: functools.partial(
            read_video,
            groups.get(number, []),
            format,
            index,
            number,
            str(path),
            is_results=isinstance(content, list),
        )
        for number, video in index.videos.items()
    }
    return SceneSet(path, format, read, dict.fromkeys(read, path), index)


def _recognize_json(path: Path, content: Content, truth: SceneSet | None) -> Format:
    if isinstance(content, TrackFile) and content.sequences is not None:
        return "burst"
    is_set = isinstance(content, list) or content.videos is not None
    rows = content if isinstance(content, list) else content.annotations or ()
    if is_set and not rows and truth is not None and truth.format in ("coco-video", "tao"):
        return truth.format
    first = rows[0] if is_set and rows else Entry()
    if first.segmentations is not None or first.bboxes is not None:
        return "coco-video"
    has_track = first.track_id is not None or first.instance_id is not None
    if first.image_id is not None and has_track:
        return "tao"
    if is_set and isinstance(content, TrackFile) and not rows:
        return "tao" if content.images else "coco-video"
    raise SourceError(
        f"{path} is no JSON of tracks: COCO-video / YouTube-VIS ('segmentations' per track), TAO "
        "('image_id' and 'track_id') or BURST ('sequences')"
    )


def is_blank(path: Path) -> bool:
    """Whether a text file holds nothing.

    Raises:
      SourceError: If it cannot be read.
    """
    try:
        return not files.read_bytes(path).strip()
    except OSError as error:
        raise SourceError(f"{path} cannot be read: {error.strerror}") from error
