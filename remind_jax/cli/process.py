"""What the verbs share: exit codes, and libraries that stay silent."""

from __future__ import annotations

import _thread
import contextlib
import os
import signal
import sys
import tempfile
import threading
import traceback
from collections.abc import Callable, Iterable, Iterator
from types import FrameType

from remind_jax.errors import first_line, shortened
from remind_jax.printing.terminal import printable

FINE = 0
ERROR = 1  # input, configuration or output is wrong: one sentence on stderr
USAGE = 2  # the words of the command make no sense
FAILED = 70  # a defect of ours: the traceback is in a file
INTERRUPTED = 130  # Ctrl-C, after finishing what was done
BROKEN_PIPE = 141  # the reader of our output went away

_TURN_S = 0.0005
_AGAIN_S = 0.05
_MOST_TIMES = 100  # that a signal waits for an import: what never ends is ended all the same


@contextlib.contextmanager
def ending_well() -> Iterator[list[int]]:
    """Lets signals end what goes on as Ctrl-C does; gives a list that they will be in.

    Raised within an import, the exception may abort the process, and what is raised within a
    callback of the garbage collector is dropped by Python: then the signal comes again.
    """
    signals: list[int] = []

    def stop(number: int, frame: FrameType | None) -> None:
        signals.append(number)
        if _is_importing(frame) and len(signals) < _MOST_TIMES:
            _send_again(number)
        else:
            raise KeyboardInterrupt

    def tell_dropped(dropped: sys.UnraisableHookArgs) -> None:
        if isinstance(dropped.exc_value, KeyboardInterrupt):
            _send_again(signals[-1] if signals else signal.SIGINT)
        else:
            former(dropped)

    former, sys.unraisablehook = sys.unraisablehook, tell_dropped
    try:
        with handling(ending_signals(), stop):
            yield signals
    finally:
        sys.unraisablehook = former


def _is_importing(frame: FrameType | None) -> bool:
    """Whether a module is being imported there."""
    while frame is not None:
        if frame.f_code.co_filename == "<frozen importlib._bootstrap>":
            return True
        frame = frame.f_back
    return False


def _send_again(number: int) -> None:
    """Sends a signal to the main thread, a moment later."""

    def send() -> None:
        if sys.platform == "win32":
            _thread.interrupt_main(number)
        else:  # wakes what waits as well
            signal.pthread_kill(threading.main_thread().ident or 0, number)

    threading.Timer(_AGAIN_S, send).start()


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
    """Signals that end a process: Ctrl-C, SIGTERM, and that the terminal was closed."""
    known = [signal.SIGINT, signal.SIGTERM]
    known += [signal.SIGHUP] if hasattr(signal, "SIGHUP") else []
    return [one for one in known if signal.getsignal(one) != signal.SIG_IGN]  # as `nohup` has it


def stopped_by(number: int | None) -> int:
    """The exit code after a signal; that of Ctrl-C if none is known."""
    return INTERRUPTED if number is None else 128 + number


def complain(sentence: str) -> None:
    """Says on standard error what is wrong, if anybody listens there."""
    with contextlib.suppress(OSError, ValueError):
        print(shortened(printable(f"remind: {sentence}")), file=sys.stderr)


def find_jax_fault() -> str:
    """Why JAX does not start in this environment, in a sentence; "" if it does."""
    try:
        import jax

        jax.devices()
    except Exception as error:  # also AssertionError without a word
        given = [f"{name}={value}" for name, value in os.environ.items() if name.startswith("JAX_")]
        why = first_line(error) if str(error) else "it finds no such device"
        return (
            f"JAX does not start with {', '.join(given) or 'this environment'}: {why}; correct it"
        )
    return ""


def report_failure(error: BaseException, chatter: str) -> None:
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
