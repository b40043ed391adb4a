"""What was freed goes back to the system."""

from __future__ import annotations

import ctypes
import resource
import sys
from pathlib import Path

import pytest

from remind_jax.compiled import freed_memory
from remind_jax.compiled.freed_memory import return_freed_memory

NUM, SIZE = 100_000, 1000  # blocks, and bytes of each: too many for pools, too small for maps


def _resident_bytes() -> int:
    return int(Path("/proc/self/statm").read_text().split()[1]) * resource.getpagesize()


@pytest.mark.skipif(
    sys.platform != "linux" or freed_memory._find_trim() is None, reason="another C library"
)
def test_freed_blocks_go_back_to_the_system():
    library = ctypes.CDLL(None)
    library.calloc.restype, library.calloc.argtypes = ctypes.c_void_p, [ctypes.c_size_t] * 2
    library.free.argtypes = [ctypes.c_void_p]
    return_freed_memory()
    before = _resident_bytes()
    blocks = [library.calloc(1, SIZE) for _ in range(NUM)]
    last = library.calloc(1, SIZE)  # what lies behind them keeps them with the process
    for block in blocks:
        ctypes.memset(block, 1, SIZE)
        library.free(block)
    assert _resident_bytes() - before > NUM * SIZE / 2
    return_freed_memory()
    assert _resident_bytes() - before < NUM * SIZE / 2
    library.free(last)


def test_without_that_library_nothing_happens(monkeypatch):
    monkeypatch.setattr(freed_memory, "_find_trim", lambda: None)
    return_freed_memory()


def test_a_library_that_cannot_is_no_error(monkeypatch):
    freed_memory._find_trim.cache_clear()
    monkeypatch.setattr(ctypes, "CDLL", lambda name: object())
    assert freed_memory._find_trim() is None
    freed_memory._find_trim.cache_clear()
