"""What the verbs share: exit codes, and libraries that stay silent."""

from __future__ import annotations

import contextlib
import signal
import sys
import tempfile
import threading
import traceback
from collections.abc import Callable, Iterable, Iterator
from types import FrameType

from remind_jax.errors import shortened
from remind_jax.printing.terminal import printable

FINE = 0
ERROR = 1  # input, configuration or output is wrong: one sentence on stderr
USAGE = 2  # the words of the command make no sense
FAILED = 70  # a defect of ours: the traceback is in a file
INTERRUPTED = 130  # Ctrl-C, after finishing what was done
BROKEN_PIPE = 141  # the reader of our output went away

_TURN_S = 0.0005


@contextlib.contextmanager
def ending_well() -> Iterator[list[int]]:
    """Lets other signals end what goes on as Ctrl-C does; gives a list that they will be in."""
    signals: list[int] = []

    def stop(number: int, frame: FrameType | None) -> None:
        signals.append(number)
        raise KeyboardInterrupt

    with handling(ending_signals(), stop):
        yield signals


@contextlib.contextmanager
def handling(
    signals: Iterable[int], handler: Callable[[int, FrameType | None], None]
) -> Iterator[None]:
    """Hands signals to a handler; in the main thread only, as Python allows."""
    is_main = threading.current_thread() is threading.main_thread()
    former = {number: signal.signal(number, handler) for number in signals if is_main}
    try:
        yield
    finally:
        for number, before in former.items():
            signal.signal(number, before)


def ending_signals() -> list[signal.Signals]:
    """Signals that end a process as Ctrl-C does: SIGTERM, and that the terminal was closed."""
    known = [signal.SIGTERM]
    known += [signal.SIGHUP] if hasattr(signal, "SIGHUP") else []
    return [one for one in known if signal.getsignal(one) != signal.SIG_IGN]  # as `nohup` has it


def stopped_by(number: int | None) -> int:
    """The exit code after a signal; that of Ctrl-C if none is known."""
    return INTERRUPTED if number is None else 128 + number


def complain(sentence: str) -> None:
    """Says on standard error what is wrong, if anybody listens there."""
    with contextlib.suppress(OSError, ValueError):
        print(shortened(printable(f"remind: {sentence}")), file=sys.stderr)


def report_failure(error: BaseException, chatter: str = "") -> None:
    """Says what broke in one sentence, and keeps the traceback for a report."""
    what = " ".join(f"{type(error).__name__}: {error}".split())[:200]
    text = "".join(traceback.format_exception(error))
    if chatter:
        text += f"\nWhat libraries said:\n{chatter}"
    try:
        with tempfile.NamedTemporaryFile(
            "w",
            encoding="utf-8",
            errors="backslashreplace",
            prefix="remind-",
            suffix=".traceback.txt",
            delete=False,
        ) as file:
            file.write(text)
        where = f"the traceback is in '{file.name}'"
    except OSError as full:
        (*_, last) = traceback.extract_tb(error.__traceback__)
        where = f"its traceback cannot be kept ({full.strerror}); its last line is "
        where += f"{last.filename}:{last.lineno}"
    complain(
        f"this should not have happened ({what}); what was written so far is kept, and {where}: "
        "please report it"
    )


def prepare_process() -> None:
    """Keeps OpenCV and FFmpeg from writing to the terminal, and lets threads take short turns.

    At Python's usual 5 ms, a frame that gives way a hundred times while a program is traced in the
    background takes most of a second. The process is that of the command alone.
    """
    import av.logging
    import cv2

    set_level = getattr(cv2, "setLogLevel", None) or cv2.utils.logging.setLogLevel
    set_level(0)
    av.logging.set_level(None)
    sys.setswitchinterval(_TURN_S)
