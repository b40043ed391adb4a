"""`remind run` of cameras and streams: what ends it, what is printed, and the page."""

import errno
import json
import os
import signal
import threading
import time
import webbrowser
from unittest import mock

import pytest

from remind_jax.cli import run as verb
from remind_jax.cli.streams import OutputStops
from remind_jax.detectors import as_detector
from remind_jax.outputs.result import Result
from remind_jax.session import run
from remind_jax.session.live import Tracker
from remind_jax.sources.feed import Feed
from tests.sources.cameras import Camera, detect

pytestmark = pytest.mark.heavy


@pytest.fixture
def camera():
    """Sends four pictures, then nothing."""
    with Camera(fps=5, most=4) as camera:
        yield camera


@pytest.fixture
def live(camera, monkeypatch):
    """A run of it with a detector that is always right."""
    monkeypatch.setattr(run, "as_detector", lambda *given: as_detector(detect, given[1]))
    return (
        "run", camera.url, "--detector", "m.onnx", "--announce-after", "1", "--no-overlay",
        "--out", "out",
    )  # fmt: skip


def test_a_stream_ends_when_nothing_more_comes(command, live):
    outcome = command(*live, "--reconnect", "0", "--record", "seen")
    assert (outcome.code, outcome.stderr) == (0, "")
    assert os.path.exists("seen/000000.png")
    assert "3 identities" in outcome.stdout
    assert "and the run with it" in outcome.stdout


@pytest.mark.parametrize(
    ("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143), (signal.SIGHUP, 129)]
)
def test_a_signal_ends_a_run_that_waits_for_its_source(
    command, camera, live, monkeypatch, number, code
):
    """The source is silent and the run waits; the signal ends it well, at once."""
    advance, done = Tracker.advance, []

    def count(self, prepared):
        tracks = advance(self, prepared)
        done.append(1)
        camera.is_stalled = True
        if len(done) == 1:
            threading.Timer(0.5, os.kill, (os.getpid(), number)).start()
        return tracks

    monkeypatch.setattr(Tracker, "advance", count)
    if code == 129:  # a terminal that is gone takes nothing more
        gone = OutputStops(OSError(errno.EIO, "Input/output error"))
        monkeypatch.setattr(verb, "print_summary", mock.Mock(side_effect=gone))
    # Tests may run under `nohup`, which has SIGHUP ignored.
    former = signal.signal(number, signal.default_int_handler)
    began = time.monotonic()
    outcome = command(*live, "--reconnect", "300")
    signal.signal(number, former)
    assert time.monotonic() - began < 200
    assert outcome.code == code
    result = Result.load("out")
    assert result.complete
    assert len(result) == len(done)
    assert not os.path.exists("out/checkpoint")


def test_a_signal_before_the_first_frame(command, live, monkeypatch):
    def wait(self, until=None):
        threading.Timer(0.3, os.kill, (os.getpid(), signal.SIGTERM)).start()
        for _ in range(20):  # the run hears the signal between two of these
            time.sleep(0.1)

    monkeypatch.setattr(Feed, "take", wait)
    outcome = command(*live, "--reconnect", "300")
    assert (outcome.code, outcome.stderr) == (143, "remind: stopped\n")


def test_a_stream_without_detector_is_told(command):
    with Camera() as camera:
        outcome = command("run", camera.url)
    assert outcome.code == 1
    assert "brings no masks; give a detector" in outcome.stderr


def test_the_address_of_the_page_is_told_and_opened_where_there_is_a_display(
    command, live, monkeypatch
):
    opened = []
    monkeypatch.setattr(webbrowser, "open", opened.append)
    monkeypatch.setattr(verb, "has_display", lambda: True)
    monkeypatch.delenv("REMIND_NO_BROWSER", raising=False)
    words = (*live, "--reconnect", "0", "--overwrite", "--json")
    outcome = command(*words, "--live", "127.0.0.1:0")
    assert outcome.stderr.startswith("live page: http://127.0.0.1:")
    assert opened == [outcome.stderr.split()[-1]]
    assert json.loads(outcome.stdout)["complete"]
    command(*words, "--live", "127.0.0.1:0", "--no-browser")
    monkeypatch.setenv("REMIND_NO_BROWSER", "1")
    command(*words, "--live", "127.0.0.1:0")
    assert len(opened) == 1


def test_a_display_is_found_by_the_environment(monkeypatch):
    monkeypatch.setattr(verb.sys, "platform", "linux")
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    assert not verb.has_display()
    monkeypatch.setenv("WAYLAND_DISPLAY", "wayland-0")
    assert verb.has_display()
