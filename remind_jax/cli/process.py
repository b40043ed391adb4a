"""What the verbs share: exit codes, and libraries that stay silent."""

from __future__ import annotations

FINE = 0
ERROR = 1  # input, configuration or output is wrong: one sentence on stderr
USAGE = 2  # the words of the command make no sense
INTERRUPTED = 130  # Ctrl-C, after finishing what was done
BROKEN_PIPE = 141  # the reader of our output went away


def silence_libraries() -> None:
    """Keeps OpenCV and FFmpeg from writing to the terminal; what fails is reported by us."""
    import av.logging
    import cv2

    set_level = getattr(cv2, "setLogLevel", None) or cv2.utils.logging.setLogLevel
    set_level(0)
    av.logging.set_level(None)
