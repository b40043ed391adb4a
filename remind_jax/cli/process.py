"""What the verbs share: exit codes, and libraries that stay silent."""

from __future__ import annotations

import sys
import tempfile
import traceback

from remind_jax.printing.terminal import printable

FINE = 0
ERROR = 1  # input, configuration or output is wrong: one sentence on stderr
USAGE = 2  # the words of the command make no sense
FAILED = 70  # a defect of ours: the traceback is in a file
INTERRUPTED = 130  # Ctrl-C, after finishing what was done
BROKEN_PIPE = 141  # the reader of our output went away


def complain(sentence: str) -> None:
    """Says on standard error what is wrong."""
    print(printable(f"remind: {sentence}"), file=sys.stderr)


def report_failure(error: BaseException) -> None:
    """Says what broke in one sentence, and keeps the traceback for a report."""
    what = " ".join(f"{type(error).__name__}: {error}".split())[:200]
    with tempfile.NamedTemporaryFile(
        "w", encoding="utf-8", prefix="remind-", suffix=".traceback.txt", delete=False
    ) as file:
        file.write("".join(traceback.format_exception(error)))
    complain(
        f"this should not have happened ({what}); what was written so far is kept, and the "
        f"traceback is in '{file.name}': please report it"
    )


def silence_libraries() -> None:
    """Keeps OpenCV and FFmpeg from writing to the terminal; what fails is reported by us."""
    import av.logging
    import cv2

    set_level = getattr(cv2, "setLogLevel", None) or cv2.utils.logging.setLogLevel
    set_level(0)
    av.logging.set_level(None)
