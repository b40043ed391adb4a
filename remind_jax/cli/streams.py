"""Standard output and error of a command: ours alone, and no error of ours if they are gone."""

from __future__ import annotations

import contextlib
import functools
import io
import os
import sys
import tempfile
import warnings
from collections.abc import Callable, Iterator
from typing import IO, Any

_STDOUT, _STDERR = 1, 2
_MAX_CHATTER = 100_000  # characters that a report keeps, the last ones
_LOUD = "0"  # of TF_CPP_MIN_LOG_LEVEL


class OutputStops(Exception):
    """Standard output takes nothing more."""

    def __init__(self, error: OSError) -> None:
        super().__init__(error.strerror or str(error))
        self.is_reader_gone = isinstance(error, BrokenPipeError)


class _Output(io.TextIOWrapper):
    """Standard output; tells its own errors from those of files."""

    def write(self, text: str) -> int:
        try:
            return super().write(text)
        except OSError as error:
            raise OutputStops(error) from error

    def flush(self) -> None:
        try:
            super().flush()
        except OSError as error:
            raise OutputStops(error) from error


class _LastingText(io.TextIOWrapper):
    """Standard error, which may go away: what cannot be written is left out."""

    def write(self, text: str) -> int:
        with contextlib.suppress(OSError):
            super().write(text)
        return len(text)

    def flush(self) -> None:
        with contextlib.suppress(OSError):
            super().flush()


def _read_end(sink: IO[bytes] | None) -> str:
    """The last of what was kept aside; empty if nothing was."""
    if sink is None:
        return ""
    sink.seek(0, os.SEEK_END)
    sink.seek(max(0, sink.tell() - _MAX_CHATTER))
    return sink.read().decode("utf-8", "replace")


@contextlib.contextmanager
def own_streams() -> Iterator[Callable[[], str]]:
    """Standard output and error for us alone; gives a function that tells what libraries said.

    libpng, the compiler and video codecs write to file descriptor 2, past Python, which is told by
    us where something really fails. The descriptor leads into a file meanwhile, and `sys.stderr`
    to where it led before. Whoever sets TF_CPP_MIN_LOG_LEVEL=0 gets to see all; warnings of Python
    are shown to those who ask for them (`-W`, PYTHONWARNINGS).
    """
    _open_closed()
    with contextlib.ExitStack() as stack:
        if _is_ours(sys.stdout, _STDOUT):
            stack.enter_context(_replaced("stdout", _STDOUT, _Output))
        is_quiet = os.environ.get("TF_CPP_MIN_LOG_LEVEL") != _LOUD
        if is_quiet and not sys.warnoptions:
            stack.enter_context(warnings.catch_warnings())
            warnings.simplefilter("ignore")
        if _is_ours(sys.stderr, _STDERR):
            stack.enter_context(_replaced("stderr", _STDERR, _LastingText))
        yield functools.partial(_read_end, _set_aside(stack) if is_quiet else None)


def _open_closed() -> None:
    """Lets closed standard streams lead nowhere, or the next file would take their place."""
    for descriptor in (0, _STDOUT, _STDERR):
        try:
            os.fstat(descriptor)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # takes the lowest number that is free


def _is_ours(stream: Any, descriptor: int) -> bool:
    """Whether a stream of Python is closed, or leads to its own descriptor."""
    if stream is None:
        return True
    try:
        return stream.fileno() == descriptor
    except (AttributeError, OSError, ValueError):
        return False


@contextlib.contextmanager
def _replaced(name: str, descriptor: int, kind: type[io.TextIOWrapper]) -> Iterator[None]:
    """`sys.stdout` or `sys.stderr` as a stream of another kind, at the same place."""
    former: Any = getattr(sys, name)
    with contextlib.suppress(OSError, AttributeError):
        former.flush()
    stream = kind(
        os.fdopen(os.dup(descriptor), "wb"),
        encoding=getattr(former, "encoding", "utf-8"),
        errors="backslashreplace",
        line_buffering=name == "stderr" or os.isatty(descriptor),
    )
    setattr(sys, name, stream)
    try:
        yield
    finally:
        setattr(sys, name, former)
        with contextlib.suppress(OSError, OutputStops):
            stream.close()


def _set_aside(stack: contextlib.ExitStack) -> IO[bytes] | None:
    """Lets descriptor 2 lead into a file until the stack is left; None if there is no room."""
    try:
        sink = tempfile.TemporaryFile(prefix="remind-")  # noqa: SIM115  (closed by the stack)
    except OSError:
        return None
    stack.enter_context(sink)
    terminal = os.dup(_STDERR)
    stack.callback(os.close, terminal)
    stack.callback(os.dup2, terminal, _STDERR)
    os.dup2(sink.fileno(), _STDERR)
    return sink
