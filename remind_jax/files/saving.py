"""Writing whole files or none, and where files are kept that can be made again."""

from __future__ import annotations

import contextlib
import functools
import os
import platform
import re
import shutil
import sys
import threading
from collections.abc import Iterator
from pathlib import Path

from remind_jax.errors import OutputError

# Machine, process and thread of who writes, after the name that the whole file will have.
_UNFINISHED = re.compile(r".+\.([\w-]+)\.(\d+)-\d+\.part")


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
    if path.exists() and not path.is_file():
        what = "a folder" if path.is_dir() else "a pipe, a device or a socket"
        raise OutputError(f"cannot write '{path}': it is {what}; name a file")
    if not path.parent.is_dir():
        raise OutputError(
            f"cannot write '{path}': there is no folder '{path.parent}'; make it, or name another "
            "file"
        )
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
