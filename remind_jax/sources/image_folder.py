"""Pictures in natural order of their names, from a folder."""

from __future__ import annotations

import functools
import math
import os
from collections.abc import Generator, Sequence
from pathlib import Path

from remind_jax.errors import SourceError
from remind_jax.formats.pictures import IMAGE_SUFFIXES, TIMES_NAME, decode_image, natural_key
from remind_jax.frame import UNTIMED_FPS, SkippedFrame
from remind_jax.sources import file_tree
from remind_jax.sources.sampling import MAX_TIME_S, mean_rate
from remind_jax.sources.source import Content, Entry, Report

# Pictures as well, which are not read.
OTHER_SUFFIXES = (
    *(".heic", ".heif", ".avif", ".jxl", ".jp2", ".exr", ".hdr", ".ppm", ".pgm", ".tga"),
    *(".dng", ".cr2", ".cr3", ".nef", ".arw", ".raf", ".orf", ".rw2"),
)


class ImageReader:
    """Pictures of one folder.

    Raises:
      SourceError: If there is no picture, one of `file_names` is missing, or times are no numbers.
    """

    kind = "images"

    def __init__(
        self, folder: Path, name: str, fps: float | None, file_names: Sequence[str] | None = None
    ) -> None:
        self._others: list[str] = []
        if file_names is None:
            file_names = list_images(folder)
            self._others = _list_by_kind(folder, OTHER_SUFFIXES)
        else:
            for file_name in file_names:
                file_tree.require_inside(file_name, f"'{folder}'")
            missing = [f for f in file_names if not os.path.isfile(folder / f)]
            if missing:
                raise SourceError(
                    f"{len(missing)} of {len(file_names)} frames that the metadata lists are "
                    f"missing in '{folder}', the first is '{missing[0]}'"
                )
        if not file_names:
            raise SourceError(f"'{folder}' holds no images ({', '.join(IMAGE_SUFFIXES)})")
        self.name = name
        shown_fps = fps or UNTIMED_FPS
        known_s = _read_times(folder, file_names)
        self._is_timed = known_s is not None or fps is not None
        self._times_s = known_s or [index / shown_fps for index in range(len(file_names))]
        self.fps: float | None = mean_rate(self._times_s, shown_fps)
        self.num_entries: int | None = len(file_names)
        self.entry_names: tuple[str, ...] | None = tuple(file_names)
        self._folder = folder

    def entries(self, report: Report) -> Generator[Entry, None, None]:
        """Yields one entry per picture."""
        for index, name in enumerate(self.entry_names or ()):
            read = functools.partial(_read, self._folder / name)
            yield Entry(index, self._times_s[index], name, read, self._is_timed)
        if self._others:
            suffix = Path(self._others[0]).suffix
            reason = f"pictures of the kind {suffix} are not read; convert them to PNG or JPEG"
            report(SkippedFrame(self._others[0], reason, count=len(self._others)))


def _read_times(folder: Path, file_names: Sequence[str]) -> list[float] | None:
    """Seconds of these pictures of a folder; None where no file tells."""
    path = folder / TIMES_NAME
    if not os.path.isfile(path):
        return None
    all_kinds = _list_by_kind(folder, (*IMAGE_SUFFIXES, *OTHER_SUFFIXES))
    names = sorted(dict.fromkeys([*all_kinds, *file_names]), key=natural_key)
    lines = file_tree.read_of_frame(path).decode("ascii", "replace").rstrip().splitlines()
    # Of a recording that was cut off, the last picture may lack.
    may_lack = [file_tree.last_number(name) for name in names] == [*range(len(names))]
    if len(lines) - len(names) not in (0, int(may_lack)):
        raise SourceError(
            f"'{path}' has {len(lines)} lines, its folder {len(names)} pictures; give one line "
            "per picture, or remove the file"
        )
    time_of: dict[str, float] = {}
    last_s = -MAX_TIME_S
    for number, (name, line) in enumerate(zip(names, lines, strict=False), 1):
        try:
            time_s = float(line)
        except ValueError:
            time_s = math.nan
        if not last_s <= time_s <= MAX_TIME_S:
            before = f", before the {last_s} of the line above" if time_s < last_s else ""
            raise SourceError(
                f"line {number} of '{path}' is {line[:40]!r}{before}; give the seconds of one "
                "picture in every line, none before those above, or remove the file"
            )
        time_of[name] = last_s = time_s
    return [time_of[name] for name in file_names]


def list_images(folder: Path) -> list[str]:
    """Names of the pictures directly in a folder."""
    return _list_by_kind(folder, IMAGE_SUFFIXES)


def _list_by_kind(folder: Path, suffixes: tuple[str, ...]) -> list[str]:
    return [n for n in file_tree.files_in(folder) if Path(n).suffix.lower() in suffixes]


def _read(path: Path) -> Content:
    return Content(decode_image(file_tree.read_of_frame(path)))
