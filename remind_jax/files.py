"""Where files of a user are kept that can be made again; reading and writing that end well."""

from __future__ import annotations

import contextlib
import errno
import os
import stat
import sys
import threading
from collections.abc import Iterator
from pathlib import Path

from remind_jax.errors import OutputError


def user_cache_folder() -> Path:
    """The folder of this package in what the system sets aside for that."""
    if sys.platform == "win32":
        base = os.environ.get("LOCALAPPDATA") or Path.home() / "AppData" / "Local"
    elif sys.platform == "darwin":
        base = Path.home() / "Library" / "Caches"
    else:
        base = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(base) / "remind-jax"


def check_regular(path: str | Path) -> None:
    """Makes sure that reading a file comes to an end: pipes and devices may go on for ever.

    Raises:
      OSError: If there is no such file, or it is a pipe, a device or a socket.
    """
    mode = os.stat(path).st_mode
    if not (stat.S_ISREG(mode) or stat.S_ISDIR(mode)):
        why = "it is a pipe, a device or a socket; give a file"
        raise OSError(errno.EINVAL, why, str(path))


def read_bytes(path: str | Path) -> bytes:
    """What a file holds.

    Raises:
      OSError: If it cannot be read, or is no file.
    """
    check_regular(path)
    return Path(path).read_bytes()


def read_text(path: str | Path) -> str:
    """What a text file in UTF-8 holds, with or without a byte order mark.

    Raises:
      OSError: If it cannot be read, is no file, or is text in another encoding.
    """
    data = read_bytes(path)
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        found = "UTF-16" if data[:2] in (b"\xff\xfe", b"\xfe\xff") else "not UTF-8"
        why = f"its text is {found} (byte {error.start}); save it as UTF-8"
        raise OSError(errno.EILSEQ, why, str(path)) from error


@contextlib.contextmanager
def writing(path: Path, *also: type[Exception]) -> Iterator[None]:
    """Turns what the system says about a failed write into one sentence that names the file.

    Args:
      path: The file being written.
      *also: Kinds of errors of the library that writes, which are no `OSError`.

    Raises:
      OutputError: Instead of the error.
    """
    try:
        yield
    except (OSError, *also) as error:
        why = getattr(error, "strerror", None) or str(error)
        raise OutputError(
            f"cannot write '{path}': {why}; what was written so far is kept, make room or choose "
            "another output folder"
        ) from error


def make_folder(folder: Path) -> None:
    """Makes the folder and its parents if they are missing.

    Raises:
      OutputError: If it cannot be made, is a file, or may not be written to.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OutputError(
            f"cannot make the output folder '{folder}': {error.strerror}; choose another one"
        ) from error
    if not os.access(folder, os.W_OK | os.X_OK):
        raise OutputError(f"the output folder '{folder}' may not be written to; choose another one")


def replace_file(path: Path, content: bytes) -> None:
    """Writes a file at once or not at all, also beside others who write the same.

    Raises:
      OutputError: If it cannot be written; an older file of this name is then kept.
    """
    partial = path.with_name(f"{path.name}.{os.getpid()}-{threading.get_ident()}.part")
    try:
        with writing(path):
            partial.write_bytes(content)
            partial.replace(path)
    finally:
        with contextlib.suppress(OSError):
            partial.unlink(missing_ok=True)
