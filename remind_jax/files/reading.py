"""Reading what a user hands over: files only, of limited size, whole, and text in UTF-8."""

from __future__ import annotations

import contextlib
import errno
import os
import stat
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from remind_jax.errors import RemindError, SourceError, first_line, is_text
from remind_jax.files.limits import MAX_FILE_BYTES, MAX_NAME_BYTES

Family = type[RemindError]
_PART_BYTES = 1 << 20


@contextlib.contextmanager
def reading(
    path: str | os.PathLike[str], refused: Family = SourceError, *, place: str = ""
) -> Iterator[None]:
    """Turns whatever a library raises on what a user handed over into one sentence.

    Args:
      place: Where in the file, such as the name of a member.

    Raises:
      RemindError: Of kind `refused`, instead of the error; those of the family pass.
    """
    where = f"'{path}'{place and f', {place}'}"
    try:
        yield
    except RemindError:
        raise
    except OSError as error:
        raise refused(f"cannot read {where}: {error.strerror or first_line(error)}") from error
    except MemoryError as error:
        raise refused(f"{where} asks for more memory than there is; split it") from error
    except RecursionError as error:
        raise refused(f"{where} is nested too deep; correct it") from error
    except Exception as error:  # of somebody else's code
        raise refused(
            f"{where} is damaged or of another form: {first_line(error)}; make it again"
        ) from error


def as_path(value: Any, what: str, refused: Family) -> Path:
    """The path that a caller gave. Raises an error of kind `refused` if it is none."""
    if not isinstance(value, (str, os.PathLike)) or isinstance(os.fspath(value), bytes):
        raise refused(f"{what} is of type {type(value).__name__}; give a path")
    if wrong := check_name(value):
        raise refused(f"{what} '{str(value)[:40]}' cannot be used: {wrong}")
    try:
        os.lstat(value)
    except PermissionError as error:
        raise refused(
            f"{what} '{value}' lies in a folder that this user may not enter; allow it, or choose "
            "another one"
        ) from error
    except OSError:
        pass  # there is nothing yet, or it will be told what is wrong with it
    return Path(value)


def check_name(path: str | os.PathLike[str]) -> str:
    """Why nothing can have this path, whatever the disk holds; empty if something can."""
    text = os.fspath(path)
    if not text:
        return "it is empty; name a file or folder"
    if "\0" in text:
        return "it holds a NUL character; take it out"
    if not is_text(text):
        return "it is no text in UTF-8; rename it"
    if len(os.fsencode(max(Path(text).parts, key=len, default=""))) > MAX_NAME_BYTES:
        return f"a name in it has over {MAX_NAME_BYTES} bytes; choose a shorter one"
    try:
        os.lstat(text)
    except OSError as error:
        if error.errno in (errno.ENAMETOOLONG, errno.ELOOP):
            return f"{(error.strerror or '').lower()}; choose another one"
    return ""


def check_regular(path: str | Path) -> None:
    """Makes sure that reading a file comes to an end: pipes and devices may go on for ever.

    Raises:
      OSError: If there is no such file, or it is a pipe, a device or a socket.
    """
    mode = os.stat(path).st_mode
    if not (stat.S_ISREG(mode) or stat.S_ISDIR(mode)):
        why = "it is a pipe, a device or a socket; give a file"
        raise OSError(errno.EINVAL, why, str(path))


def say_no_file(path: str | Path) -> str:
    """Why no file can be read at a path, as the end of a sentence; empty if one can."""
    try:
        check_regular(path)
    except FileNotFoundError:
        return "does not exist"
    except (OSError, ValueError) as error:
        return f"cannot be read ({getattr(error, 'strerror', None) or error})"
    return "is a folder" if os.path.isdir(path) else ""


def check_size(path: str | Path, max_bytes: int) -> None:
    """Makes sure that a file fits the memory that is meant for it, before it is read.

    Raises:
      OSError: If there is no such file, or it is larger.
    """
    if (size := os.stat(path).st_size) > max_bytes:
        why = f"it has {say_bytes(size)}, at most {say_bytes(max_bytes)} are read; split it"
        raise OSError(errno.EFBIG, why, str(path))


def read_bytes(path: str | Path, max_bytes: int = MAX_FILE_BYTES) -> bytes:
    """What a file holds.

    Raises:
      OSError: If it cannot be read, is no file, or is larger than `max_bytes`.
    """
    check_regular(path)
    check_size(path, max_bytes)
    with Path(path).open("rb") as file:
        said = os.fstat(file.fileno()).st_size
        data = file.read(said + 1)
        if len(data) <= said:
            return data
        # It grows, or is one of those that the system makes up while they are read.
        parts, num_bytes = [data], len(data)
        while part := file.read(_PART_BYTES):
            parts.append(part)
            num_bytes += len(part)
            if num_bytes > max_bytes:
                why = f"it has over {say_bytes(max_bytes)}, which are not read; split it"
                raise OSError(errno.EFBIG, why, str(path))
        return b"".join(parts)


def read_text(path: str | Path, max_bytes: int = MAX_FILE_BYTES) -> str:
    """What a text file in UTF-8 holds, with or without a byte order mark.

    Raises:
      OSError: If it cannot be read, is no file, is larger than `max_bytes`, or is text in another
        encoding.
    """
    data = read_bytes(path, max_bytes)
    if wrong := wrong_encoding(data):
        raise OSError(errno.EILSEQ, wrong, str(path))
    return data.decode("utf-8-sig")


def wrong_encoding(data: bytes) -> str:
    """Half a sentence on text that is not UTF-8; nothing if it is."""
    if data[:2] in (b"\xff\xfe", b"\xfe\xff") or b"\x00" in data[:4]:
        return "its text is UTF-16, UTF-32 or no text at all; save it as UTF-8"
    try:
        if not data.isascii():
            data.decode("utf-8")
    except UnicodeDecodeError as error:
        return f"its text is not UTF-8 (byte {error.start}); save it as UTF-8"
    return ""


def say_bytes(size: int) -> str:
    """A size in words, in the largest unit of which there is one."""
    for unit, place in (("GiB", 30), ("MiB", 20), ("KiB", 10)):
        if size >= 1 << place:
            return f"{size / (1 << place):.4g} {unit}"
    return f"{size} bytes"
