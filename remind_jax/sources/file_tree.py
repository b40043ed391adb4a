"""Files of a folder by name, in natural order; names of files that lead nowhere else."""

from __future__ import annotations

import contextlib
import os
import re
from collections.abc import Callable
from pathlib import Path, PurePosixPath

from remind_jax import files
from remind_jax.errors import SourceError
from remind_jax.formats.pictures import IMAGE_SUFFIXES, natural_key
from remind_jax.sources.source import UnreadableFrame


def files_in(folder: Path) -> list[str]:
    """Names of the files directly in a folder, naturally sorted; none if it is missing.

    Links that lead nowhere or in circles are files that cannot be read.
    """
    return _names(folder, _is_file_or_lost)


def folders_in(folder: Path) -> list[str]:
    """Names of the folders directly in a folder, naturally sorted."""
    return _names(folder, os.DirEntry.is_dir)


def _is_file_or_lost(entry: os.DirEntry[str]) -> bool:
    return (entry.is_symlink() and not os.path.exists(entry.path)) or entry.is_file()


def _names(folder: Path, is_wanted: Callable[[os.DirEntry[str]], bool]) -> list[str]:
    """Names that are not hidden."""
    names = []
    try:
        with os.scandir(folder) as entries:
            for entry in entries:
                with contextlib.suppress(OSError):
                    if is_wanted(entry) and not entry.name.startswith("."):
                        names.append(entry.name)
    except (FileNotFoundError, NotADirectoryError, ValueError):
        return []
    except OSError as error:
        raise SourceError(f"folder '{folder}' cannot be read: {error.strerror or error}") from error
    return sorted(names, key=natural_key)


def read_of_frame(path: Path) -> bytes:
    """A whole file that belongs to one frame. Raises UnreadableFrame if it cannot be read."""
    try:
        return files.read_bytes(path)
    except OSError as error:
        raise UnreadableFrame(f"cannot be read: {error.strerror or error}") from error


def read_bytes(path: Path) -> bytes:
    """A whole file on disk. Raises SourceError if it cannot be read."""
    with files.reading(path):
        return files.read_bytes(path)


def last_number(name: str) -> int | None:
    """The last group of digits in the stem of a file name: `frame_000610.png` is 610."""
    digits = re.findall(r"\d+", PurePosixPath(name).stem)
    return int(digits[-1]) if digits else None


def frame_stem(name: str) -> str:
    """`DSC1` of `DSC1.JPG` as of `DSC1.JPG.png`: what pictures and their maps have in common."""
    inner = PurePosixPath(PurePosixPath(name).stem)
    return inner.stem if inner.suffix.lower() in IMAGE_SUFFIXES else inner.name


def require_inside(name: str, where: str) -> None:
    """Makes sure that a name from a file leads nowhere else.

    Raises:
      SourceError: If it is absolute, or leads out of its folder, or no file can have it.
    """
    parts = re.split(r"[\\/]", name)
    is_absolute = name.startswith(("/", "\\")) or re.match(r"[A-Za-z]:", name) is not None
    if is_absolute or ".." in parts or "\0" in name:
        raise SourceError(
            f"{where}: '{name[:200]}' leads out of its folder; give names of files in it"
        )
