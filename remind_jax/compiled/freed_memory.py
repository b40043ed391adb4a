"""Memory that was freed and stays with the process until somebody asks for it."""

from __future__ import annotations

import ctypes
import functools
from collections.abc import Callable


def return_freed_memory() -> None:
    """Gives what was freed back to the system, where its C library can: that of GNU.

    Making a program or loading it takes some hundred megabytes until it ends, which would stay
    with the process for good. It takes some 20 ms then, in which other threads of Python go on.
    """
    trim = _find_trim()
    if trim is not None:
        trim(0)


@functools.cache
def _find_trim() -> Callable[[int], int] | None:
    try:
        return ctypes.CDLL(None).malloc_trim
    except (AttributeError, OSError, TypeError):  # another library, or another system
        return None
