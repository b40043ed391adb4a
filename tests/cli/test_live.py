"""`remind run` of cameras and streams: what ends it, what is printed, and the page."""

from __future__ import annotations

import json
import os
import signal
import threading
import time
import webbrowser

import pytest

from remind_jax.cli import run as verb
from remind_jax.outputs.result import Result
from remind_jax.session.live import Tracker
from remind_jax.sources.feed import Feed
from tests.cli import scenes
from tests.sources.cameras import Camera


@pytest.fixture
def growing(tmp_path):
    """A folder with its masks, that nothing is added to."""
    images, masks = scenes.write_scene(tmp_path / "scene")
    return (
        "run", images, "--masks", masks, "--follow", "--every-frame", "--no-overlay", "--out", "out"
    )  # fmt: skip


def test_a_growing_folder_ends_when_nothing_more_comes(command, growing):
    outcome = command(*growing, "--reconnect", "1", "--record", "seen")
    assert (outcome.code, outcome.stderr) == (0, "")
    assert outcome.stdout.startswith("images: 4 frames, 3 identities")
    assert "got no picture for 1 s, and the run with it" in outcome.stdout
    again = command(
        "run", "seen", "--masks", "seen/detections.jsonl", "--no-overlay", "--out", "again"
    )
    assert again.code == 0
    ids = [[t.object_id.tolist() for t in Result.load(name).tracks] for name in ("out", "again")]
    assert ids[0] == ids[1]


@pytest.mark.parametrize(("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_a_signal_ends_a_run_that_waits_for_its_source(command, growing, monkeypatch, number, code):
    """The run has done all frames and waits; the signal ends it well, at once."""
    advance, done = Tracker.advance, []

    def count(self, prepared):
        tracks = advance(self, prepared)
        done.append(1)
        if len(done) == 4:
            threading.Timer(0.5, os.kill, (os.getpid(), number)).start()
        return tracks

    monkeypatch.setattr(Tracker, "advance", count)
    began = time.monotonic()
    outcome = command(*growing, "--reconnect", "300")
    assert time.monotonic() - began < 200
    assert outcome.code == code
    result = Result.load("out")
    assert result.complete
    assert len(result) == 4
    assert not os.path.exists("out/checkpoint")


def test_a_signal_before_the_first_frame(command, growing, tmp_path, monkeypatch):
    take, asked = Feed.take, []

    def count(self, until=None):
        asked.append(1)
        if len(asked) == 1:  # the run waits, so that it hears the signal
            threading.Timer(0.3, os.kill, (os.getpid(), signal.SIGTERM)).start()
        return take(self, until)

    monkeypatch.setattr(Feed, "take", count)
    for picture in (tmp_path / "scene" / "images").iterdir():
        picture.unlink()
    outcome = command(*growing, "--reconnect", "300")
    assert (outcome.code, outcome.stderr) == (143, "remind: stopped\n")


def test_a_stream_without_detector_is_told(command):
    with Camera() as camera:
        outcome = command("run", camera.url)
    assert outcome.code == 1
    assert "brings no masks; give a detector" in outcome.stderr


def test_a_stream_that_refuses(command):
    outcome = command("run", "rtsp://me:secret@127.0.0.1:1/x", "--detector", "m.onnx")
    assert outcome.code == 1
    assert outcome.stderr.startswith("remind: 'rtsp://***@127.0.0.1:1/x' refuses the connection;")
    assert "secret" not in outcome.stderr


def test_the_address_of_the_page_is_told_and_opened_where_there_is_a_display(
    command, growing, monkeypatch
):
    opened = []
    monkeypatch.setattr(webbrowser, "open", opened.append)
    monkeypatch.setattr(verb, "has_display", lambda: True)
    monkeypatch.delenv("REMIND_NO_BROWSER", raising=False)
    words = (*growing, "--reconnect", "0.5", "--overwrite", "--json")
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


def test_what_follows_live_is_an_address(command):
    outcome = command("run", "--live", "0", static=())
    assert outcome.code == 2
    assert "SOURCE" in outcome.stderr
