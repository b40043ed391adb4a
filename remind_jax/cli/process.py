"""What the verbs share: exit codes, libraries that stay silent, files that are written."""

from __future__ import annotations

from pathlib import Path

from remind_jax.errors import OutputError

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


def write_text(path: Path, text: str) -> None:
    """Writes a file that a flag names.

    Raises:
      OutputError: If it cannot be written.
    """
    try:
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        raise OutputError(f"cannot write '{path}': {error.strerror}") from error
