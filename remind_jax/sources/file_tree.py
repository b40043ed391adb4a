"""Files below a folder, by names that lead nowhere else; `""` is the top."""

from __future__ import annotations

import os
import re
from pathlib import Path, PurePosixPath
from typing import IO

from remind_jax import files
from remind_jax.errors import SourceError
from remind_jax.files.limits import MAX_FILE_BYTES
from remind_jax.sources.source import UnreadableFrame


class FileTree:
    """A folder on disk."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def files_in(self, folder: str) -> list[str]:
        """Names of the files directly in a folder, naturally sorted; none if it is missing."""
        return self._names(folder, files=True)

    def folders_in(self, folder: str) -> list[str]:
        """Names of the folders directly in a folder, naturally sorted."""
        return self._names(folder, files=False)

    def has_file(self, path: str) -> bool:
        """Whether there is a file of this path."""
        try:
            return (self.path / path).is_file()
        except (OSError, ValueError):  # a name that no file can have
            return False

    def read(self, path: str) -> bytes:
        """The whole file. Raises UnreadableFrame if it cannot be read."""
        try:
            return files.read_bytes(self.path / path, MAX_FILE_BYTES)
        except OSError as error:
            raise UnreadableFrame(f"cannot be read: {error.strerror or error}") from error

    def open(self, path: str) -> IO[bytes]:
        """The file as a stream of bytes."""
        return (self.path / path).open("rb")

    def locate(self, path: str) -> str:
        """The file as text for messages."""
        return str(self.path / path)

    def _names(self, folder: str, *, files: bool) -> list[str]:
        try:
            with os.scandir(self.path / folder) as entries:
                names = [e.name for e in entries if _is_there(e, files=files)]
        except (FileNotFoundError, NotADirectoryError, ValueError):
            return []
        except OSError as error:
            raise SourceError(
                f"folder '{self.path / folder}' cannot be read: {error.strerror or error}"
            ) from error
        return sorted((name for name in names if not name.startswith(".")), key=natural_key)


def open_tree(path: Path) -> FileTree:
    """The files of a folder. Raises SourceError if it is none."""
    if path.is_dir():
        return FileTree(path)
    raise SourceError(
        f"'{path}' is no folder; masks are a folder of instance maps (.png), an array (.npz, "
        ".npy), or COCO run-length JSON"
    )


def read_bytes(path: Path) -> bytes:
    """A whole file on disk. Raises SourceError if it cannot be read."""
    try:
        return files.read_bytes(path)
    except OSError as error:
        raise SourceError(f"'{path}' cannot be read: {error.strerror or error}") from error


def natural_key(name: str) -> tuple[tuple[int, int, str], ...]:
    """Sorts `frame_9` before `frame_10`."""
    parts = re.split(r"(\d+)", name)
    return tuple((0, int(p), p) if p.isdecimal() else (1, 0, p.lower()) for p in parts if p)


def last_number(name: str) -> int | None:
    """The last group of digits in the stem of a file name: `frame_000610.png` is 610."""
    digits = re.findall(r"\d+", PurePosixPath(name).stem)
    return int(digits[-1]) if digits else None


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


def join(folder: str, name: str) -> str:
    """Path of a name in a folder of a tree."""
    return f"{folder}/{name}" if folder else name


def _is_there(entry: os.DirEntry[str], *, files: bool) -> bool:
    """Whether it is a file or a folder; links that lead nowhere or in circles are neither."""
    try:
        return entry.is_file() if files else entry.is_dir()
    except OSError:
        return False
