"""Files that can be made again, with a digest at the end, by which damage is found."""

from __future__ import annotations

import contextlib
import hashlib
from pathlib import Path

from remind_jax.files.limits import MAX_FILE_BYTES
from remind_jax.files.reading import read_bytes
from remind_jax.files.saving import replace_file

_DIGEST_BYTES = 32


def write_sealed(path: Path, content: bytes) -> None:
    """Writes a file, whole or not at all, as `replace_file`."""
    replace_file(path, content + _digest(path, content))


def read_sealed(path: Path, max_bytes: int = MAX_FILE_BYTES) -> bytes | None:
    """What was written there; None if there is nothing sound, and then it is removed."""
    with contextlib.suppress(OSError):
        data = read_bytes(path, max_bytes)
        content, digest = data[:-_DIGEST_BYTES], data[-_DIGEST_BYTES:]
        if digest == _digest(path, content):
            return content
    remove_sealed(path)
    return None


def remove_sealed(path: Path) -> None:
    """Removes what stands where such a file should; a folder with something in it stays."""
    with contextlib.suppress(OSError):
        if path.is_dir() and not path.is_symlink():
            path.rmdir()
        else:
            path.unlink(missing_ok=True)


def _digest(path: Path, content: bytes) -> bytes:
    """A content under the name of another one is damaged."""
    name = f"{path.parent.name}/{path.name}"
    return hashlib.sha256(name.encode() + b"\0" + content).digest()
