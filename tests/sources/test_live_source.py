"""Streams as sources: newest frames, counted gaps, connections lost and found again."""

import functools
import gc
import math
import subprocess
import sys
import threading
import time

import numpy as np
import pytest

import remind_jax as rj
from remind_jax.errors import OptionError, SourceError, UnreadableFrame
from remind_jax.frame import SkippedFrame
from remind_jax.sources import LiveSource, Sampling
from remind_jax.sources.capture import Picture
from remind_jax.sources.live_source import PASSED_OVER, LiveOptions, LiveReader
from remind_jax.sources.source import Content
from tests.sources.cameras import Camera, number_in
from tests.sources.rtsp_camera import RtspCamera
from tests.sources.test_feed import wait_for

pytestmark = pytest.mark.heavy


def open_live(*args, **options) -> LiveSource:
    source = rj.open_source(*args, **options)
    assert isinstance(source, LiveSource)
    return source


def numbers_of(frames: list[rj.Frame]) -> list[int]:
    return [number_in(frame.image) for frame in frames if frame.image is not None]


def test_a_slow_reader_gets_the_newest_frame_and_the_gaps_are_counted():
    frames, num_arrived = [], 0
    with Camera(fps=50) as camera:
        source = open_live(camera.url)
        for frame in source:
            assert number_in(frame.image) >= num_arrived - 1, "a frame waited"
            frames.append(frame)
            num_arrived = source.status().num_arrived + 3
            wait_for(lambda least=num_arrived: source.status().num_arrived >= least)
            if len(frames) == 6:
                source.stop()
    numbers = numbers_of(frames)
    gaps = np.diff(numbers)
    assert np.median(gaps) >= 2
    assert [frame.source_index for frame in frames] == [n - numbers[0] for n in numbers]
    assert [frame.index for frame in frames] == list(range(6))
    (passed_over,) = source.skipped
    assert (passed_over.reason, passed_over.count) == (PASSED_OVER, (gaps - 1).sum())
    assert source.status().num_missed == passed_over.count


class Growing:
    """Larger and larger pictures, every second one damaged; each when the last was looked at."""

    def __init__(self) -> None:
        self.num, self.looked_at = 0, threading.Semaphore()

    def read(self) -> Picture | None:
        self.looked_at.acquire(timeout=20)
        self.num += 1
        return functools.partial(self._look, self.num) if self.num < 7 else None

    def _look(self, number: int) -> Content:
        self.looked_at.release()
        if number % 2 == 0:
            raise UnreadableFrame("the picture is damaged")
        return Content(np.zeros((8, 8 * number, 3), np.uint8))

    def close(self) -> None:
        pass


def test_frames_may_change_their_size_and_damaged_ones_are_counted():
    capture = Growing()
    reader = LiveReader("stream", "it", "it", lambda wait_s: capture, LiveOptions(reconnect=0))
    source = LiveSource(reader, Sampling())
    assert [frame.size for frame in source] == [(8, 8), (8, 24), (8, 40)]
    assert source.skipped == [SkippedFrame("000001", "the picture is damaged", 3)]
    assert len([news for news in source.take_news() if "is damaged" in news]) == 1
    assert source.take_news() == []


def test_a_source_is_silent_while_all_its_pictures_are_left_out():
    capture = Growing()
    reader = LiveReader("stream", "it", "it", lambda wait_s: capture, LiveOptions(reconnect=0))
    source = LiveSource(reader, Sampling())
    silent_s = []
    for frame in source:  # and a damaged one after each
        time.sleep(0.1)
        silent_s.append(source.status().silent_s)
        if frame.index:
            source.leave_out(SkippedFrame(frame.name, "it is too small"))
    assert silent_s[2] >= silent_s[1] + 0.1 >= 0.2
    assert source.status().silent_s >= silent_s[2]


def test_times_are_those_of_arrival():
    with Camera(fps=20) as camera:
        source = open_live(camera.url, sampling={"max_frames": 5})
        began = time.monotonic()
        frames = list(source)
        took_s = time.monotonic() - began
        assert 0 <= source.age_s(frames[-1]) < took_s
    times = np.array([frame.time_s for frame in frames])
    assert times[0] == 0
    assert (np.diff(times) > 0).all()
    assert 0.1 < times[-1] <= took_s


@pytest.mark.parametrize("is_stalled", [False, True])
def test_duration_ends_a_stream_also_one_that_is_silent(is_stalled):
    with Camera(fps=30) as camera:
        source = open_live(camera.url, duration=0.5)
        frames = iter(source)
        first = next(frames)
        arrived = time.monotonic() - source.age_s(first)
        camera.is_stalled = is_stalled
        last = [first, *frames][-1]
        assert 0.5 <= time.monotonic() - arrived < 5
    assert last.time_s <= 0.5


def test_a_script_that_keeps_its_source_ends_without_a_word():
    script = (
        "import os, sys, remind_jax as rj\n"
        "source = rj.open_source(sys.argv[1], sampling={'max_frames': 2})\n"
        "os.kept = source  # is cleared later than threading\n"
        "print(len(list(source)))\n"
    )
    with Camera(fps=30) as camera:
        done = subprocess.run(
            [sys.executable, "-c", script, camera.url], capture_output=True, text=True, timeout=120
        )
    assert (done.returncode, done.stdout, done.stderr) == (0, "2\n", "")


def test_it_can_be_gone_through_again():
    with Camera(fps=30) as camera:
        source = open_live(camera.url, sampling={"max_frames": 2})
        first, second = numbers_of(list(source)), numbers_of(list(source))
    assert second[0] > first[-1]


def test_nothing_counts_before_everything_is_ready():
    seen = []

    def get_ready(content):
        seen.append(number_in(content.image))
        num_arrived = source.status().num_arrived
        wait_for(lambda: source.status().num_arrived >= num_arrived + 6)

    with Camera(fps=50) as camera:
        source = open_live(camera.url, sampling={"max_frames": 1})
        source.get_ready_by(get_ready)
        (frame,) = source
    assert number_in(frame.image) >= seen[0] + 5
    assert (frame.source_index, frame.time_s) == (0, 0.0)
    assert source.skipped == []


def test_a_source_that_nobody_reads_is_let_go():
    with Camera() as camera:
        source = open_live(camera.url)
        feed = source._live.feed
        del source
        gc.collect()
        feed._thread.join(20)
        assert not feed._thread.is_alive()


def test_masks_cannot_belong_to_a_stream():
    with Camera() as camera, pytest.raises(SourceError, match="live, so that no masks can belong"):
        rj.open_source(camera.url, masks="masks/")


def test_options_out_of_range_are_named():
    for name, values in (("duration", (0, float("inf"), "5")), ("reconnect", (-1, math.nan, None))):
        for value in values:
            with pytest.raises(OptionError, match=f"'{name}' is {value!r}"):
                LiveOptions(**{name: value})


def test_options_for_live_sources_are_refused_for_others(tmp_path):
    (tmp_path / "a.mp4").touch()
    with pytest.raises(OptionError, match="'duration'"):
        rj.open_source(tmp_path / "a.mp4", duration=1)
    with pytest.raises(OptionError, match="'reconnect'"):
        rj.open_source(np.zeros((2, 8, 8, 3), np.uint8), reconnect=1)


def test_an_rtsp_camera_drops_out_and_comes_back():
    numbers, news = [], []
    with RtspCamera() as camera:
        source = open_live(camera.url, reconnect=60)
        for frame in source:
            numbers.append(number_in(frame.image))
            news += source.take_news()
            if len(numbers) == 5:
                camera.switch_off()
                threading.Timer(0.6, camera.switch_on).start()
            if news and len(numbers) > 15:
                source.stop()
    assert len(news) == 1
    assert news[0].startswith(f"'{camera.url}' was lost for")
    assert (np.diff(numbers) > 0).all()
