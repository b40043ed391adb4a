"""Decoding runs ahead of the tracker, in one thread, by a bounded number of items."""

from __future__ import annotations

import collections
from collections.abc import Callable, Generator, Iterable
from concurrent.futures import ThreadPoolExecutor
from typing import Any, TypeVar

ItemT = TypeVar("ItemT")

MAX_WAITING_BYTES = 1 << 28
_END = object()


def prefetch(
    items: Iterable[ItemT], *, depth: int, size_of: Callable[[ItemT], int]
) -> Generator[ItemT, None, None]:
    """Yields the items, which are made up to `depth` ahead.

    The iteration runs in one background thread, which is started by the first `next`. An exception
    of it is raised at its place, after the items before it. Closing the generator (leaving a loop,
    an exception, Ctrl-C) ends the thread before it returns; the wait is at most the item in work.

    Args:
      size_of: Bytes of an item; fewer wait where some would take more than `MAX_WAITING_BYTES`
        together, if all are as large as the last one.
    """
    iterator = iter(items)

    def advance() -> Any:
        return next(iterator, _END)

    pool = ThreadPoolExecutor(1, "prefetch")
    # How large items are is not known before the first one.
    ahead = collections.deque([pool.submit(advance)])
    try:
        while (item := ahead.popleft().result()) is not _END:
            fits = MAX_WAITING_BYTES // max(1, size_of(item))
            while len(ahead) <= min(depth, fits):
                ahead.append(pool.submit(advance))
            yield item
    finally:
        pool.shutdown(cancel_futures=True)
        close = getattr(iterator, "close", None)
        if close is not None:
            close()
