"""Decoding runs ahead of the tracker, in one thread, by a bounded number of items."""

from __future__ import annotations

import queue
import threading
from collections.abc import Callable, Generator, Iterable, Iterator
from typing import Any, TypeVar

ItemT = TypeVar("ItemT")
ResultT = TypeVar("ResultT")

_END = object()


class _Failure:
    """An exception of the background thread, kept at its place in the order of items."""

    def __init__(self, error: BaseException) -> None:
        self.error = error


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
    results: queue.Queue[Any] = queue.Queue(maxsize=depth)
    stop = threading.Event()
    thread = threading.Thread(
        target=_produce, args=(items, function, results, stop), name="prefetch", daemon=True
    )
    thread.start()
    try:
        while (result := results.get()) is not _END:
            if isinstance(result, _Failure):
                raise result.error
            yield result
    finally:
        stop.set()
        _drain(results)
        thread.join()


def _produce(
    items: Iterable[Any],
    function: Callable[[Any], Any] | None,
    results: queue.Queue[Any],
    stop: threading.Event,
) -> None:
    """Fills the queue. After `stop` one more `put` may happen; the emptied queue has room."""
    iterator: Iterator[Any] | None = None
    last: Any = _END
    try:
        iterator = iter(items)
        for item in iterator:
            if stop.is_set():
                break
            result = item if function is None else function(item)
            results.put(result)
            if stop.is_set():
                break
    except BaseException as error:
        last = _Failure(error)
    finally:
        close = getattr(iterator, "close", None)
        if close is not None:
            close()
    if not stop.is_set():
        results.put(last)


def _drain(results: queue.Queue[Any]) -> None:
    """Empties the queue, so that a producer waiting for room sees that it shall stop."""
    while True:
        try:
            results.get_nowait()
        except queue.Empty:
            return
