"""Tar archives opened with limits: no member or header makes them take much memory or time."""

from __future__ import annotations

import bz2
import gzip
import io
import lzma
import tarfile
import zlib
from pathlib import Path
from typing import Any

# What the libraries raise on archives that are no good.
DAMAGED = (OSError, EOFError, tarfile.TarError, zlib.error, lzma.LZMAError, ValueError)

_OPENERS = {
    b"\x1f\x8b": gzip.open,
    b"BZh": bz2.open,
    b"\xfd7zXZ": lzma.open,
    b"\x5d\0\0": lzma.open,
}
_MOST_HEADER_BYTES = 1 << 20
_FREE_BYTES = 1 << 30  # unpacked, whatever the archive's size
_MOST_RATIO = 100  # of unpacked to packed; pictures and masks do not reach it


class Excessive(tarfile.TarError):
    """The archive asks for more memory or time than is meant for it."""


class Archive(tarfile.TarFile):
    """A tar archive that is read.

    Attributes:
      is_plain: Not compressed.
    """

    is_plain: bool

    def close(self) -> None:
        """Closes the file below as well."""
        super().close()
        if self.fileobj is not None:
            self.fileobj.close()


def open_archive(path: Path, most_member_bytes: int = _MOST_HEADER_BYTES) -> Archive:
    """Opens an archive, compressed or not.

    Raises:
      One of `DAMAGED`: If it is no archive, or asks for too much.
    """
    with path.open("rb") as file:
        start = file.read(6)
    opener = next((o for magic, o in _OPENERS.items() if start.startswith(magic)), None)
    most_bytes = max(_FREE_BYTES, _MOST_RATIO * path.stat().st_size)
    unpacked: Any = path.open("rb") if opener is None else opener(path, "rb")
    limited = _Limited(unpacked, most_bytes)
    try:
        archive = Archive(fileobj=limited)
    except BaseException:
        unpacked.close()
        raise
    archive.is_plain = opener is None
    limited.most_read_bytes = most_member_bytes
    return archive


class _Limited(io.RawIOBase):
    """A stream that refuses to be read in large pieces, or too far."""

    def __init__(self, file: Any, most_bytes: int) -> None:
        self._file, self._most_bytes = file, most_bytes
        self.most_read_bytes = _MOST_HEADER_BYTES

    def read(self, size: int = -1) -> bytes:
        """At most so many bytes."""
        if not 0 <= size <= self.most_read_bytes:
            raise Excessive(f"a header or member claims {size} bytes")
        return self._file.read(size)

    def seek(self, offset: int, whence: int = io.SEEK_SET) -> int:
        """Goes to a place."""
        if offset > self._most_bytes:
            raise Excessive(f"it unpacks to over {self._most_bytes >> 30} GiB; pack it otherwise")
        return self._file.seek(offset, whence)

    def tell(self) -> int:
        """The place."""
        return self._file.tell()

    def close(self) -> None:
        """Closes the file below as well."""
        self._file.close()
        super().close()
