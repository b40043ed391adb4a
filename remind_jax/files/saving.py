"""Writing: files whole or not at all, apart from what is read, one process to a folder."""

from __future__ import annotations

import contextlib
import functools
import os
import platform
import re
import shutil
import sys
import threading
from collections.abc import Callable, Collection, Iterable, Iterator
from pathlib import Path
from typing import Any

from filelock import FileLock, Timeout

from remind_jax.errors import OutputError


def refuse_folder(
    folder: Path, inputs: Iterable[Any], ours: Collection[str] = (), *, may_hold: bool = False
) -> None:
    """Makes sure that files of an output folder never come among the inputs.

    Args:
      ours: Names of which one is in a folder that we wrote. Another one that is not empty is
        refused below a folder that is read, if there are such names: it may be that of the images.

    Raises:
      OutputError: If the folder is an input, or holds one.
    """
    out = resolve(folder)
    held = {path.name for path in folder.iterdir()} if ours and folder.is_dir() else set()
    for path in map(resolve, _paths(inputs)):
        if out == path or (out in path.parents and not may_hold):
            what = "is" if out == path else "holds"
            raise OutputError(
                f"the output folder '{folder}' {what} the input '{path}', which would be mixed up "
                "with what is written; choose another folder"
            )
        if path in out.parents and held and not held & {*ours}:
            raise OutputError(
                f"the output folder '{folder}' lies in the input '{path}' and holds other files; "
                "choose an empty or another folder"
            )


def refuse_file(
    file: Path, inputs: Iterable[Any], *, is_read: Callable[[str], bool] = lambda name: True
) -> None:
    """Makes sure that a file that is written replaces nothing that is read.

    Args:
      is_read: Which names of files in such a folder are read; all if left out.

    Raises:
      OutputError: If the file is an input, or one of the files of an input folder.
    """
    out = resolve(file)
    for path in map(resolve, _paths(inputs)):
        if out == path or (path in out.parents and out.exists() and is_read(out.name)):
            where = "is" if out == path else f"belongs to '{path}', which is"
            raise OutputError(f"the output '{file}' {where} an input; choose another name")


def _paths(values: Iterable[Any]) -> list[Path]:
    return [Path(value) for value in values if isinstance(value, (str, os.PathLike))]


def resolve(path: Path) -> Path:
    """Where a path leads to, links followed. Raises OutputError if it leads nowhere."""
    try:
        return path.expanduser().resolve()
    except (OSError, RuntimeError, ValueError) as error:
        why = getattr(error, "strerror", None) or str(error)
        raise OutputError(f"'{str(path)[:200]}' cannot be used: {why}") from error


def check_place(file: Path) -> None:
    """Makes sure that a file may lie there, before the work is done whose result it is to hold.

    Raises:
      OutputError: If it is a folder, or its folder is missing.
    """
    if file.is_dir():
        raise OutputError(f"cannot write '{file}': it is a folder; name a file")
    if not file.parent.is_dir():
        raise OutputError(
            f"cannot write '{file}': there is no folder '{file.parent}'; make it, or name another "
            "file"
        )


# Machine, process and thread of who writes, after the name that the whole file will have.
_UNFINISHED = re.compile(r".+\.([\w-]+)\.(\d+)-\d+\.part")


def user_cache_folder() -> Path:
    """The folder of this package in what the system sets aside for that."""
    if sys.platform == "win32":
        base = os.environ.get("LOCALAPPDATA") or _home() / "AppData" / "Local"
    elif sys.platform == "darwin":
        base = _home() / "Library" / "Caches"
    else:
        base = os.environ.get("XDG_CACHE_HOME") or _home() / ".cache"
    return Path(base) / "remind-jax"


def _home() -> Path:
    try:
        return Path.home()
    except RuntimeError:  # of a user whom the system does not know: nothing is kept
        return Path("/nonexistent")


@contextlib.contextmanager
def writing(path: Path, *also: type[Exception]) -> Iterator[None]:
    """Turns what the system says about a failed write into one sentence that names the file.

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
        leads_nowhere = folder.is_symlink() and not folder.exists()
        why = "it is a link that leads nowhere" if leads_nowhere else error.strerror
        raise OutputError(
            f"cannot make the output folder '{folder}': {why}; choose another one"
        ) from error
    if not os.access(folder, os.W_OK | os.X_OK):
        raise OutputError(f"the output folder '{folder}' may not be written to; choose another one")


def replace_file(path: Path, content: bytes) -> None:
    """Writes a file at once or not at all, also beside others who write the same.

    Raises:
      OutputError: If it cannot be written; an older file of this name is then kept.
    """
    with replacing(path) as partial:
        partial.write_bytes(content)


@contextlib.contextmanager
def replacing(path: Path, *also: type[Exception], durably: bool = False) -> Iterator[Path]:
    """A file to write to, which takes the place of another one when the block is left well.

    Args:
      durably: Wait until it is on the disk, so that a power cut leaves one of the two whole.

    Raises:
      OutputError: If it cannot be written, or is a device or a pipe, whose place no file may take;
        an older file of this name is then kept.
    """
    check_place(path)
    if path.exists() and not path.is_file():
        raise OutputError(f"cannot write '{path}': it is a pipe, a device or a socket; name a file")
    partial = path.with_name(f"{path.name}.{_writer()}.part")
    try:
        with writing(path, *also):
            yield partial
            if durably:
                _wait_for_disk(partial)
            partial.replace(path)
            if durably and os.name != "nt":
                _wait_for_disk(path.parent)  # its name as well
    finally:
        with contextlib.suppress(OSError):
            partial.unlink(missing_ok=True)


def append_durably(path: Path, content: bytes) -> None:
    """Adds to a file, which there is, and returns when that is on the disk.

    Raises:
      OutputError: If it cannot be written; the file may end with a part of it.
    """
    with writing(path), path.open("ab") as file:
        file.write(content)
        file.flush()
        os.fsync(file.fileno())


@contextlib.contextmanager
def replacing_folder(path: Path, beside: Path) -> Iterator[Path]:
    """A folder to fill, which takes the place of another one when the block is left well.

    Args:
      beside: A folder of the same disk, which holds the new one until then; need not be there.

    Raises:
      OutputError: If it cannot be written; all is then as it was before.
    """
    if path.exists() and not path.is_dir():
        raise OutputError(f"cannot write '{path}': it is a file; name a folder")
    folders = (beside, path.parent)
    made = [folder for folder in folders if not folder.exists()]
    for folder in folders:
        make_folder(folder)
    partial = beside / f"{path.name}.{_writer()}.part"
    former = partial.with_suffix(".former")  # not swept up: it may be all that there is
    try:
        partial.mkdir()
        yield partial
        if path.exists():
            path.rename(former)
        partial.rename(path)
    except OSError as error:
        raise OutputError(
            f"cannot write '{path}': {error.strerror or error}; nothing there was changed, make "
            "room or choose another output folder"
        ) from error
    finally:
        if former.exists() and not path.exists():  # stopped between the two
            former.rename(path)
        for folder in (partial, former):
            shutil.rmtree(folder, ignore_errors=True)
        for folder in reversed(made):
            with contextlib.suppress(OSError):
                folder.rmdir()  # if nothing came into it


def remove_unfinished(folder: Path) -> None:
    """Removes what processes of this machine that are no more were still writing.

    What has the number of a process that runs is left alone.
    """
    for path in folder.glob("*.part"):
        found = _UNFINISHED.fullmatch(path.name)
        if found and found[1] == _machine() and not _is_running(int(found[2])):
            with contextlib.suppress(OSError):
                shutil.rmtree(path) if path.is_dir() else path.unlink()


def _writer() -> str:
    """Who writes, as a part of a name: machine, process and thread."""
    return f"{_machine()}.{os.getpid()}-{threading.get_ident()}"


@functools.cache
def _machine() -> str:
    return re.sub(r"[^\w-]+", "_", platform.node())[:40] or "here"


def _is_running(process: int) -> bool:
    """Whether there is a process of this number."""
    if os.name == "nt":
        return True  # signal 0 would end it there
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except (OSError, OverflowError):
        return True
    return True


def _wait_for_disk(path: Path) -> None:
    """Returns when a file, or the names in a folder, would outlive a power cut."""
    number = os.open(path, os.O_RDONLY)
    try:
        os.fsync(number)
    finally:
        os.close(number)


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
