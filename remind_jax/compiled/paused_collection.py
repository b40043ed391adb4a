"""Python's garbage collector, paused while a program is traced.

A trace makes millions of small objects that live until it ends; the collector would go through all
of them again and again, which takes a sixth of the time.
"""

from __future__ import annotations

import contextlib
import gc
import threading
from collections.abc import Iterator

_lock = threading.Lock()
_paused: list[bool] = []  # of each thread within, whether the collector ran before


@contextlib.contextmanager
def paused_collection() -> Iterator[None]:
    """Nothing is collected within, in any thread; goes on when the last thread has left."""
    with _lock:
        _paused.append(_paused[0] if _paused else gc.isenabled())
        gc.disable()
    try:
        yield
    finally:
        with _lock:
            ran = _paused.pop()
            if ran and not _paused:
                gc.enable()
