"""The line of a run: what it says, and where."""

from __future__ import annotations

import io
import sys
import time
import types

import pytest

import remind_jax.session.progress
from remind_jax.session.progress import Progress, RunLine, follow_run


def done(num_done: int, ms: float = 12.3) -> Progress:
    return Progress(num_done, 10, ms, 4, 0.25)


def test_a_frame_that_takes_long_is_reported():
    now = [100.0]
    line = RunLine("rooms", 10, is_shown=False, clock=lambda: now[0])
    line(done(5))
    now[0] += 2
    assert "ms/frame" in line.facts()
    now[0] += 5
    assert line.facts() == "frame 6 takes 7 s so far"
    line(done(6, ms=2000))  # such frames take seconds
    now[0] += 7
    assert "ms/frame" in line.facts()


class Terminal(io.StringIO):
    """A terminal that remembers what was written."""

    def isatty(self) -> bool:
        return True


def test_a_terminal_shows_the_line_and_forgets_it(monkeypatch):
    screen = Terminal()
    monkeypatch.setattr(sys, "stderr", screen)
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setenv("COLUMNS", "80")
    with follow_run(None, "rooms", 10) as follow:
        assert follow is not None
        assert "preparing the tracker" in screen.getvalue()
        assert "0/10" not in screen.getvalue()
        follow(done(3))
    shown = screen.getvalue()
    assert "3/10" in shown
    assert "4 identities" in shown
    assert shown.endswith("\x1b[2K")  # the line is wiped


def test_nothing_where_nobody_looks_on(capfd):
    with follow_run(None, "rooms", 10) as follow:
        assert follow is not None
        follow(done(1))
    assert capfd.readouterr() == ("", "")


def test_false_is_nothing_and_a_function_is_called_as_it_is(monkeypatch):
    screen = Terminal()
    monkeypatch.setattr(sys, "stderr", screen)
    seen: list[Progress] = []
    with follow_run(False, "rooms", 10) as nothing, follow_run(seen.append, "rooms", 10) as follow:
        assert nothing is None
        assert follow is not None
        follow(done(1))
    assert seen == [done(1)]
    assert screen.getvalue() == ""


class Output:
    """What a cell of a notebook shows."""

    def __init__(self) -> None:
        self.pages: list[str] = []

    def display(self, page: str, display_id: bool) -> Output:
        self.pages.append(page)
        return self

    def update(self, page: str) -> None:
        self.pages.append(page)


def test_a_notebook_shows_the_line_and_forgets_it(monkeypatch):
    output = Output()
    kernel = type("ZMQInteractiveShell", (), {})()
    monkeypatch.setitem(sys.modules, "IPython", types.SimpleNamespace(get_ipython=lambda: kernel))
    monkeypatch.setattr(
        remind_jax.session.progress,
        "_notebook_display",
        lambda: (output.display, lambda text: text),
    )
    monkeypatch.setattr(remind_jax.session.progress, "_NOTEBOOK_REFRESH_S", 0.01)
    with follow_run(None, "a<b", 10) as follow:
        assert follow is not None
        assert "a&lt;b: preparing the tracker, 0 s" in output.pages[0]
        follow(done(3))
        for _ in range(500):
            if 'value="3" max="10"' in output.pages[-1]:
                break
            time.sleep(0.01)
        else:
            pytest.fail("the page was not written anew")
    assert output.pages[-1] == ""
