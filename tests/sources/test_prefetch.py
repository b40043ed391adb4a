import threading
import time

import pytest

from remind_jax.sources import prefetch as module
from tests.sources.test_feed import wait_for


def prefetch(items, depth=4, size_of=lambda item: 1):
    return module.prefetch(items, depth=depth, size_of=size_of)


def alive():
    return [t for t in threading.enumerate() if t.name.startswith("prefetch")]


def test_keeps_order():
    for depth in (1, 2, 7):
        assert list(prefetch(range(50), depth)) == list(range(50))
        assert list(prefetch(iter("abc"), depth)) == ["a", "b", "c"]
    assert list(prefetch([])) == []
    assert not alive()


def test_error_of_the_iterable_is_raised_after_its_items():
    def items():
        yield from range(4)
        raise KeyError("late")

    results = prefetch(items(), depth=1)
    assert next(results) == 0
    time.sleep(0.02)
    assert [next(results) for _ in range(3)] == [1, 2, 3]
    with pytest.raises(KeyError, match="late"):
        next(results)


@pytest.mark.parametrize("depth", [1, 4])
def test_runs_ahead_but_not_further_than_depth(depth):
    started = []
    results = prefetch(map(started.append, range(100)), depth)
    next(results)
    # The consumer took one, `depth` wait and one is in work (its result waits for room).
    wait_for(lambda: len(started) == depth + 2)
    time.sleep(0.02)
    assert len(started) == depth + 2
    results.close()
    assert not alive()


def test_early_stop_ends_the_thread_and_closes_the_iterable():
    closed = threading.Event()

    def endless():
        try:
            while True:
                yield 0
        finally:
            closed.set()

    results = prefetch(endless())
    next(results)
    results.close()
    assert closed.is_set()
    assert not alive()


def test_nothing_starts_before_the_first_item_is_wanted():
    def items():
        pytest.fail("started too early")
        yield

    prefetch(items()).close()
    assert not alive()


@pytest.mark.parametrize(("size", "num_ahead"), [(1, 4), (100 << 20, 3), (1 << 30, 1)])
def test_large_results_wait_in_small_numbers(size, num_ahead):
    """Besides the one in work: two of 100 MiB fit, none of a GiB."""
    started = []

    def start(number):
        started.append(number)
        return number

    results = prefetch(map(start, range(100)), 3, size_of=lambda _: size)
    next(results)
    wait_for(lambda: len(started) == 1 + num_ahead)
    time.sleep(0.02)
    assert len(started) == 1 + num_ahead
    assert next(results) == 1
    results.close()
