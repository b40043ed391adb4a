"""Files below a folder or inside a tar, read in place; `""` is the top."""

from __future__ import annotations

import bz2
import gzip
import io
import lzma
import os
import re
import tarfile
import weakref
import zlib
from collections.abc import Iterable
from pathlib import Path, PurePosixPath
from typing import IO, Any

from remind_jax import files
from remind_jax.errors import SourceError, first_line
from remind_jax.files.limits import (
    MAX_FILE_BYTES,
    MAX_HEADER_BYTES,
    MAX_TAR_MEMBERS,
    MAX_UNPACKED_BYTES,
    MAX_UNPACKED_RATIO,
)
from remind_jax.sources.source import UnreadableFrame

TAR_SUFFIXES = (".tar", ".tar.gz", ".tgz", ".tar.bz2", ".tbz2", ".tar.xz", ".txz")
STREAMED_SUFFIXES = (".mkv", ".mp4", ".mov", ".avi", ".webm", ".m4v", ".bin", ".ply")
LAYOUT_FOLDERS = ("JPEGImages", "Annotations", "annotations", "dslr", "iphone")  # never a wrapper
_OPENERS = {
    b"\x1f\x8b": gzip.open,
    b"BZh": bz2.open,
    b"\xfd7zXZ": lzma.open,
    b"\x5d\0\0": lzma.open,
}
# What the libraries raise on archives that are no good.
_DAMAGED = (OSError, EOFError, tarfile.TarError, zlib.error, lzma.LZMAError, ValueError)

# Files of an archive by name, and whether it ends early.
Listed = tuple[dict[str, tarfile.TarInfo], bool]


class FolderTree:
    """A folder on disk; `TarTree` answers the same questions about an archive."""

    is_cut_off = False

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

    def second_handle(self) -> FolderTree:
        """The same tree with a read position of its own (compressed tars rewind slowly)."""
        return self

    def _names(self, folder: str, *, files: bool) -> list[str]:
        try:
            with os.scandir(self.path / folder) as entries:
                return _sort(e.name for e in entries if _is_there(e, files=files))
        except (FileNotFoundError, NotADirectoryError, ValueError):
            return []
        except OSError as error:
            raise SourceError(
                f"folder '{self.path / folder}' cannot be read: {error.strerror or error}"
            ) from error


class TarTree:
    """A tar archive, compressed or not; a single folder around everything is looked through.

    Raises:
      SourceError: If it cannot be read, or a member lies outside of it, is no file, or too large.
    """

    def __init__(self, path: Path, listed: Listed | None = None) -> None:
        self.path = path
        self._archive: _Archive | None = None
        self._listed = _list_members(path) if listed is None else listed
        self._members, self.is_cut_off = self._listed
        self._folders: dict[str, set[str]] = {"": set()}
        self._files: dict[str, set[str]] = {}
        for name in self._members:
            pure = PurePosixPath(name)
            self._files.setdefault(_folder_name(pure.parent), set()).add(pure.name)
            for parent in pure.parents[:-1]:
                self._folders.setdefault(_folder_name(parent.parent), set()).add(parent.name)

    def files_in(self, folder: str) -> list[str]:
        """Names of the files directly in a folder, naturally sorted; none if it is missing."""
        return _sort(self._files.get(_folder_name(PurePosixPath(folder)), ()))

    def folders_in(self, folder: str) -> list[str]:
        """Names of the folders directly in a folder, naturally sorted."""
        return _sort(self._folders.get(_folder_name(PurePosixPath(folder)), ()))

    def has_file(self, path: str) -> bool:
        """Whether there is a file of this path."""
        return path in self._members

    def read(self, path: str) -> bytes:
        """The whole file. Raises UnreadableFrame if it cannot be read."""
        try:
            with self.open(path) as file:
                data = file.read()
        except _DAMAGED as error:
            raise UnreadableFrame(
                f"cannot be read from the archive: {first_line(error)}"
            ) from error
        if len(data) != self._members[path].size:
            raise UnreadableFrame(
                f"only {len(data)} of its {self._members[path].size} bytes are in the archive"
            )
        return data

    def open(self, path: str) -> IO[bytes]:
        """The file as a stream of bytes."""
        if self._archive is None:
            self._archive = _open_archive(self.path, MAX_FILE_BYTES)  # kept open between frames
            weakref.finalize(self, self._archive.close)
        file = self._archive.extractfile(self._members[path])
        assert file is not None, "only regular files are listed"
        return file

    def locate(self, path: str) -> str:
        """The file as text for messages."""
        return f"{self.path}:{path}"

    def second_handle(self) -> TarTree:
        """The same tree with a read position of its own."""
        return TarTree(self.path, self._listed)


FileTree = FolderTree | TarTree


def open_tree(path: Path) -> FileTree:
    """A folder or a tar, by what is there. Raises SourceError if it is neither."""
    if path.is_dir():
        return FolderTree(path)
    if is_tar_name(path.name):
        return TarTree(path)
    raise SourceError(
        f"'{path}' is neither a folder nor a tar archive; masks are such, with instance maps "
        "(.png), or an array (.npz, .npy), or COCO run-length JSON"
    )


def read_bytes(path: Path) -> bytes:
    """A whole file on disk. Raises SourceError if it cannot be read."""
    try:
        return files.read_bytes(path)
    except OSError as error:
        raise SourceError(f"'{path}' cannot be read: {error.strerror or error}") from error


def is_tar_name(name: str) -> bool:
    """Whether a file name is that of a tar archive."""
    return name.lower().endswith(TAR_SUFFIXES)


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


def _sort(names: Iterable[str]) -> list[str]:
    """Names in natural order, hidden files left out."""
    return sorted((name for name in names if not name.startswith(".")), key=natural_key)


def _is_there(entry: os.DirEntry[str], *, files: bool) -> bool:
    """Whether it is a file or a folder; links that lead nowhere or in circles are neither."""
    try:
        return entry.is_file() if files else entry.is_dir()
    except OSError:
        return False


def _folder_name(path: PurePosixPath) -> str:
    return "" if str(path) == "." else str(path)


def _list_members(path: Path) -> Listed:
    """Regular files by name; a truncated archive gives what came before the cut."""
    members: dict[str, tarfile.TarInfo] = {}
    try:
        files.check_regular(path)
        with _open_archive(path) as archive:
            while (member := _next_member(archive, bool(members))) is not None:
                if danger := _say_danger(member):
                    raise SourceError(
                        f"archive '{path}' is refused: member '{member.name[:200]}' {danger}"
                    )
                if len(members) >= MAX_TAR_MEMBERS:
                    raise SourceError(f"archive '{path}' has too many files; split it")
                if member.isreg():
                    members[str(PurePosixPath(member.name))] = member
            is_cut_off = not _has_end(archive)
    except _DAMAGED as error:
        raise SourceError(f"archive '{path}' cannot be read: {first_line(error)}") from error
    if not members:
        raise SourceError(f"archive '{path}' holds no files")
    return _strip_top(members), is_cut_off


def _next_member(archive: tarfile.TarFile, has_members: bool) -> tarfile.TarInfo | None:
    try:
        return archive.next()
    except _DAMAGED as error:
        if has_members and not isinstance(error, _Excessive):
            return None
        raise


def _has_end(archive: tarfile.TarFile) -> bool:
    """Whether a block of zeros follows the last member, as it should."""
    assert archive.fileobj is not None
    try:
        archive.fileobj.seek(archive.offset)
        return archive.fileobj.read(tarfile.BLOCKSIZE) == bytes(tarfile.BLOCKSIZE)
    except _DAMAGED:
        return False


def _say_danger(member: tarfile.TarInfo) -> str | None:
    """Why a member is not acceptable; None if it is."""
    if member.name.startswith(("/", "\\")) or ".." in re.split(r"[\\/]", member.name):
        return "lies outside of it; pack with plain relative paths"
    if not (member.isdir() or (member.isreg() and PurePosixPath(member.name).parts)):
        return "is no file or folder with a name; pack with 'tar -h --hard-dereference'"
    if member.issparse():
        return "is a sparse file; pack without 'tar --sparse'"
    if member.size > MAX_FILE_BYTES and not member.name.lower().endswith(STREAMED_SUFFIXES):
        return f"claims {member.size} bytes; at most {MAX_FILE_BYTES} are accepted"
    return None


class _Excessive(tarfile.TarError):
    """The archive asks for more memory or time than is meant for it."""


class _Archive(tarfile.TarFile):
    """Closes the file below as well."""

    def close(self) -> None:
        super().close()
        if self.fileobj is not None:
            self.fileobj.close()


def _open_archive(path: Path, max_member_bytes: int = MAX_HEADER_BYTES) -> _Archive:
    """Opens an archive, compressed or not, of which no header or member is read beyond limits.

    Raises:
      One of `_DAMAGED`: If it is no archive, or asks for too much.
    """
    with path.open("rb") as file:
        start = file.read(6)
    opener = next((o for magic, o in _OPENERS.items() if start.startswith(magic)), None)
    max_bytes = max(MAX_UNPACKED_BYTES, MAX_UNPACKED_RATIO * path.stat().st_size)
    unpacked: Any = path.open("rb") if opener is None else opener(path, "rb")
    limited = _Limited(unpacked, max_bytes)
    try:
        archive = _Archive(fileobj=limited)
    except BaseException:
        unpacked.close()
        raise
    limited.max_read_bytes = max_member_bytes
    return archive


class _Limited(io.RawIOBase):
    """A stream that refuses to be read in large pieces, or too far."""

    def __init__(self, file: Any, max_bytes: int) -> None:
        self._file, self._max_bytes = file, max_bytes
        self.max_read_bytes = MAX_HEADER_BYTES

    def read(self, size: int = -1) -> bytes:
        if not 0 <= size <= self.max_read_bytes:
            raise _Excessive(f"a header or member claims {size} bytes")
        return self._file.read(size)

    def seek(self, offset: int, whence: int = io.SEEK_SET) -> int:
        if offset > self._max_bytes:
            raise _Excessive(f"it unpacks to over {self._max_bytes >> 30} GiB; pack it otherwise")
        return self._file.seek(offset, whence)

    def tell(self) -> int:
        return self._file.tell()

    def close(self) -> None:
        self._file.close()
        super().close()


def _strip_top(members: dict[str, tarfile.TarInfo]) -> dict[str, tarfile.TarInfo]:
    """Removes the one folder that everything lies in, if there is one that only wraps."""
    tops = {PurePosixPath(name).parts[0] for name in members}
    if len(tops) != 1 or any(len(PurePosixPath(name).parts) == 1 for name in members):
        return members
    top = tops.pop()
    if top in LAYOUT_FOLDERS:
        return members
    return {name[len(top) + 1 :]: member for name, member in members.items()}
