"""Writing whole files or none, and where files are kept that can be made again."""

from __future__ import annotations

import contextlib
import os
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
