"""What the command line, unlike the library, sets for its whole process."""

from __future__ import annotations


def silence_libraries() -> None:
    """Keeps OpenCV and FFmpeg from writing to the terminal; what fails is told by us."""
    import av.logging
    import cv2

    set_level = getattr(cv2, "setLogLevel", None) or cv2.utils.logging.setLogLevel
    set_level(0)
    av.logging.set_level(None)
