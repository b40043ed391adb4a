"""Files below a folder or inside a tar, read in place: nothing is ever unpacked to disk.

Paths inside a tree are relative, with forward slashes; `""` is the top.
"""

from __future__ import annotations

import os
import re
import tarfile
import weakref
from collections.abc import Iterable
from pathlib import Path, PurePosixPath
from typing import IO

from remind_jax import files
from remind_jax.errors import SourceError, first_line
from remind_jax.sources.archive import DAMAGED, Archive, Excessive, open_archive
from remind_jax.sources.source import UnreadableFrame

TAR_SUFFIXES = (".tar", ".tar.gz", ".tgz", ".tar.bz2", ".tbz2", ".tar.xz", ".txz")
STREAMED_SUFFIXES = (".mkv", ".mp4", ".mov", ".avi", ".webm", ".m4v", ".bin", ".ply")
LAYOUT_FOLDERS = ("JPEGImages", "Annotations", "annotations", "dslr", "iphone")  # never a wrapper
MOST_FILE_BYTES = 1 << 29  # of a file that is read as a whole: images, masks, JSON
MOST_NAME, MOST_PART = 4096, 1000  # characters of a path in an archive, and between slashes
MOST_MEMBERS = 2_000_000  # of an archive


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
        """The whole file.

        Raises:
          UnreadableFrame: If it cannot be read.
        """
        try:
            return files.read_bytes(self.path / path, MOST_FILE_BYTES)
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
      SourceError: If the archive cannot be read or a member could reach outside of it or exhaust
        the machine: absolute paths, `..`, links, devices, sparse or giant files.
    """

    def __init__(self, path: Path, listed: Listed | None = None) -> None:
        self.path = path
        self._archive: Archive | None = None
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
        """The whole file.

        Raises:
          UnreadableFrame: If it cannot be read.
        """
        try:
            with self.open(path) as file:
                data = file.read()
        except DAMAGED as error:
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
            self._archive = open_archive(self.path, MOST_FILE_BYTES)  # kept open between frames
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
    """A folder or a tar, by what is there.

    Raises:
      SourceError: If it is neither.
    """
    if path.is_dir():
        return FolderTree(path)
    if is_tar_name(path.name):
        return TarTree(path)
    raise SourceError(
        f"'{path}' is neither a folder nor a tar archive; masks are such, with instance maps "
        "(.png), or an array (.npz, .npy), or COCO run-length JSON"
    )


def read_bytes(path: Path) -> bytes:
    """A whole file on disk.

    Raises:
      SourceError: If it cannot be read.
    """
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
        archive_bytes = path.stat().st_size
        with open_archive(path) as archive:
            is_plain = archive.is_plain
            while (member := _next_member(archive, bool(members))) is not None:
                danger = _say_danger(member, archive_bytes if is_plain else None)
                if danger:
                    raise SourceError(
                        f"archive '{path}' is refused: member '{member.name[:200]}' {danger}"
                    )
                if len(members) >= MOST_MEMBERS:
                    raise SourceError(f"archive '{path}' has over {MOST_MEMBERS} files; split it")
                if member.isreg():
                    members[str(PurePosixPath(member.name))] = member
            is_cut_off = not _has_end(archive)
    except SourceError:
        raise
    except DAMAGED as error:
        raise SourceError(f"archive '{path}' cannot be read: {first_line(error)}") from error
    if not members:
        raise SourceError(f"archive '{path}' holds no files")
    return _strip_top(members), is_cut_off


def _next_member(archive: Archive, has_members: bool) -> tarfile.TarInfo | None:
    try:
        return archive.next()
    except Excessive:
        raise
    except DAMAGED:
        if has_members:
            return None
        raise


def _has_end(archive: Archive) -> bool:
    """Whether a block of zeros follows the last member, as it should."""
    assert archive.fileobj is not None
    try:
        archive.fileobj.seek(archive.offset)
        return archive.fileobj.read(tarfile.BLOCKSIZE) == bytes(tarfile.BLOCKSIZE)
    except DAMAGED:
        return False


def _say_danger(member: tarfile.TarInfo, archive_bytes: int | None) -> str | None:
    """Why a member is not acceptable; None if it is."""
    name = member.name
    if not PurePosixPath(name).parts and not member.isdir():
        return "has no name"
    if len(name) > MOST_NAME or max(map(len, PurePosixPath(name).parts), default=0) > MOST_PART:
        return f"has a name of {len(name)} characters; pack with shorter names"
    if name.startswith("/") or re.match(r"^[A-Za-z]:[\\/]|^\\", name):
        return "has an absolute path; pack with relative paths"
    if ".." in re.split(r"[\\/]", name):
        return "points outside with '..'; pack with plain relative paths"
    if member.issym() or member.islnk():
        return f"is a link to '{member.linkname[:200]}'; pack with 'tar -h --hard-dereference'"
    if member.isdir():
        return None
    if not member.isreg():
        return "is a device or pipe; only files and folders are read"
    if member.issparse():
        return "is a sparse file; pack without 'tar --sparse'"
    if archive_bytes is not None and member.size > archive_bytes:
        return f"claims {member.size} bytes, more than the whole archive has"
    if member.size > MOST_FILE_BYTES and not name.lower().endswith(STREAMED_SUFFIXES):
        return f"claims {member.size} bytes; at most {MOST_FILE_BYTES} are accepted"
    return None


def _strip_top(members: dict[str, tarfile.TarInfo]) -> dict[str, tarfile.TarInfo]:
    """Removes the one folder that everything lies in, if there is one that only wraps."""
    tops = {PurePosixPath(name).parts[0] for name in members}
    if len(tops) != 1 or any(len(PurePosixPath(name).parts) == 1 for name in members):
        return members
    top = tops.pop()
    if top in LAYOUT_FOLDERS:
        return members
    return {name[len(top) + 1 :]: member for name, member in members.items()}
