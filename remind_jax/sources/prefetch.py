"""Decoding runs ahead of the tracker, in one thread, by a bounded number of items."""

from __future__ import annotations

import collections
from collections.abc import Callable, Generator, Iterable
from concurrent.futures import ThreadPoolExecutor
from typing import Any, TypeVar

ItemT = TypeVar("ItemT")

_END = object()


def prefetch(
    items: Iterable[ItemT],
    function: Callable[[ItemT], Any] | None = None,
    depth: int = 4,
) -> Generator[Any, None, None]:
    """Yields `function(item)` for each item, computed up to `depth` items ahead.

    The iteration and `function` run in one background thread, which is started by the first
    `next`. An exception of either is raised at its place, after the results before it. Closing
    the generator (leaving a loop, an exception, Ctrl-C) ends the thread before it returns; the
    wait is at most the item in work.

    Args:
      items: What is iterated, in the background.
      function: Applied to each item, in the background; left out, items pass unchanged.
      depth: Results that may wait, besides the one in work.

    Raises:
      ValueError: If `depth` is below 1.
    """
    if depth < 1:
        raise ValueError(f"prefetch depth is {depth}; give 1 or more")
    return _run_ahead(items, function, depth)


def _run_ahead(
    items: Iterable[Any], function: Callable[[Any], Any] | None, depth: int
) -> Generator[Any, None, None]:
    iterator = iter(items)

    def advance() -> Any:
        item = next(iterator, _END)
        return item if item is _END or function is None else function(item)

    pool = ThreadPoolExecutor(1, "prefetch")
    ahead = collections.deque(pool.submit(advance) for _ in range(depth + 1))
    try:
        while (result := ahead.popleft().result()) is not _END:
            ahead.append(pool.submit(advance))
            yield result
    finally:
        pool.shutdown(cancel_futures=True)
        close = getattr(iterator, "close", None)
        if close is not None:
            close()
