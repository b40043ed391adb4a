"""Decoding runs ahead of the tracker, in one thread, by a bounded number of items."""

from __future__ import annotations

import collections
from collections.abc import Callable, Generator, Iterable
from concurrent.futures import ThreadPoolExecutor
from typing import Any, TypeVar

ItemT = TypeVar("ItemT")
ResultT = TypeVar("ResultT")

MAX_WAITING_BYTES = 1 << 28
_END = object()


def prefetch(
    items: Iterable[ItemT],
    function: Callable[[ItemT], ResultT],
    *,
    depth: int,
    size_of: Callable[[ResultT], int],
) -> Generator[ResultT, None, None]:
    """Yields `function(item)` for each item, computed up to `depth` items ahead.

    The iteration and `function` run in one background thread, which is started by the first
    `next`. An exception of either is raised at its place, after the results before it. Closing
    the generator (leaving a loop, an exception, Ctrl-C) ends the thread before it returns; the
    wait is at most the item in work.

    Args:
      size_of: Bytes of a result; fewer wait where some would take more than `MAX_WAITING_BYTES`
        together, if all are as large as the last one.
    """
    iterator = iter(items)

    def advance() -> Any:
        item: Any = next(iterator, _END)
        return item if item is _END else function(item)

    pool = ThreadPoolExecutor(1, "prefetch")
    # How large results are is not known before the first one.
    ahead = collections.deque([pool.submit(advance)])
    try:
        while (result := ahead.popleft().result()) is not _END:
            fits = MAX_WAITING_BYTES // max(1, size_of(result))
            while len(ahead) <= min(depth, fits):
                ahead.append(pool.submit(advance))
            yield result
    finally:
        pool.shutdown(cancel_futures=True)
        close = getattr(iterator, "close", None)
        if close is not None:
            close()
