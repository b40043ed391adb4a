"""The newest picture of a source that goes on by itself, whatever it does."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

import pytest

from remind_jax.errors import SourceError
from remind_jax.sources import feed as feeds
from remind_jax.sources.capture import Lost, Picture, Unreachable
from remind_jax.sources.feed import Feed
from remind_jax.sources.source import Content

PATIENCE_S = 20.0


class Script:
    """A source that does what it is told: "picture", "lost", "ended", or waits for `go`."""

    def __init__(self, *steps: str) -> None:
        self.steps, self.opened, self.closed = list(steps), 0, 0
        self.go, self.over = threading.Event(), threading.Event()
        self.refuses = 0  # so many attempts to open it

    def open(self, wait_s: float) -> Script:
        if self.opened and self.refuses:
            self.refuses -= 1
            raise Unreachable("'it' refuses the connection; is it on?")
        self.opened += 1
        return self

    def read(self) -> Picture | None:
        if not self.steps:
            self.over.wait(PATIENCE_S)
            return None
        step = self.steps.pop(0)
        if step == "wait":
            self.go.wait(PATIENCE_S)
            return self.read()
        if step == "lost":
            raise Lost("broke off")
        if step == "defect":
            raise ZeroDivisionError
        return Content if step == "picture" else None

    def close(self) -> None:
        self.closed += 1


def start(script: Script, reconnect_s: float = PATIENCE_S) -> Feed:
    return Feed(script.open, "it", reconnect_s=reconnect_s, wait_s=1.0)


def wait_for(condition: Callable[[], bool]) -> None:
    end = time.monotonic() + PATIENCE_S
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.005)


@pytest.fixture(autouse=True)
def in_no_time(monkeypatch):
    monkeypatch.setattr(feeds, "_FIRST_PAUSE_S", 0.01)


def test_who_is_slow_gets_the_newest():
    feed = start(Script(*5 * ["picture"]))
    wait_for(lambda: feed.num_arrived == 5)
    arrival = feed.take()
    assert arrival.number == 4
    assert feed.take(time.monotonic()) is None
    feed.stop()


def test_a_picture_given_back_makes_room_for_a_newer_one():
    script = Script("picture", "wait", "picture")
    feed = start(script)
    first = feed.take()
    feed.put_back(first)
    assert feed.take() == first
    script.go.set()
    wait_for(lambda: feed.num_arrived == 2)
    feed.put_back(first)
    second = feed.take()
    assert second.number == 1
    feed.stop()


def test_a_lost_source_is_opened_again_and_that_is_told_once():
    script = Script("picture", "lost", "wait", "picture")
    script.refuses = 2
    feed = start(script)
    assert feed.take() is not None
    wait_for(lambda: script.opened == 2)
    assert feed.state == "lost"
    script.go.set()
    assert feed.take() is not None
    assert feed.state == "connected"
    (told,) = feed.take_news()
    assert told.startswith("'it' was lost for ")
    assert feed.take_news() == []
    feed.stop()


def test_a_source_that_ends_is_opened_again_too():
    script = Script("picture", "ended", "picture")
    feed = start(script)
    wait_for(lambda: feed.num_arrived == 2)
    assert script.opened == 2
    feed.stop()


def test_a_source_that_stays_away_ends_with_an_error_after_what_it_gave():
    script = Script("picture", "lost")
    script.refuses = 1_000_000
    feed = start(script, reconnect_s=0.2)
    wait_for(lambda: feed.state == "ended")
    assert feed.take() is not None
    with pytest.raises(SourceError) as caught:
        feed.take()
    told = "'it' was lost ('it' refuses the connection) and did not come back within 0.2 s;"
    assert str(caught.value).startswith(told)


@pytest.mark.parametrize("last", ["lost", "ended"])
def test_without_patience_the_source_ends_the_run(last):
    feed = start(Script("picture", last), reconnect_s=0.0)
    wait_for(lambda: feed.state == "ended")
    assert feed.take() is not None
    assert feed.take() is None
    assert feed.take_news()[0].endswith("and the run with it")


def test_a_source_that_gives_nothing_at_all_is_an_error():
    feed = start(Script("lost"))
    with pytest.raises(SourceError, match="'it' broke off before its first picture"):
        feed.take()


def test_a_defect_is_told_where_pictures_are_waited_for():
    feed = start(Script("picture", "defect"))
    wait_for(lambda: feed.state == "ended")
    feed.take()
    with pytest.raises(SourceError, match="'it' cannot be read: ZeroDivisionError"):
        feed.take()


def test_stopping_wakes_who_waits_and_closes_the_source():
    script = Script("picture")
    feed = start(script)
    assert feed.take() is not None
    threading.Timer(0.05, feed.stop).start()
    assert feed.take() is None
    script.over.set()
    wait_for(lambda: script.closed > 0)
    assert feed.state == "ended"


def test_stopping_ends_the_attempts_to_reconnect():
    script = Script("picture", "lost")
    script.refuses = 1_000_000
    feed = start(script)
    wait_for(lambda: feed.state == "lost")
    feed.stop()
    assert feed.state == "ended"
