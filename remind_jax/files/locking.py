"""Folders that one process writes to at a time; a process that died is no obstacle."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from pathlib import Path

from filelock import FileLock, Timeout

from remind_jax.errors import OutputError
from remind_jax.files.saving import make_folder, remove_unfinished

LOCK_NAME = ".lock"


@contextlib.contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Keeps a folder, which is made if needed, from other processes.

    The system lets go of what a process had that died; what it was writing is removed.

    Raises:
      OutputError: If another process, or another run of this one, has the folder, or it cannot be
        written to.
    """
    is_new = not folder.exists()
    make_folder(folder)
    path = folder / LOCK_NAME
    lock = FileLock(path, thread_local=False)
    try:
        lock.acquire(blocking=False)
    except Timeout as error:
        raise OutputError(
            f"'{folder}' is in use by another run; wait until it ends, or choose another folder"
        ) from error
    except OSError as error:
        raise OutputError(
            f"cannot write '{path}': {error.strerror or error}; choose another folder"
        ) from error
    try:
        remove_unfinished(folder)
        yield
    finally:
        with contextlib.suppress(OSError):
            path.unlink()
        lock.release()
        if is_new:
            with contextlib.suppress(OSError):
                folder.rmdir()  # if nothing came into it
