"""Runs of live sources: how old what is shown is, connections lost, records, and what ends them."""

import json
import re
import threading
import time
import urllib.request
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

import remind_jax as rj
from remind_jax.cli.main import main
from remind_jax.errors import OptionError, OutputError, SourceError
from remind_jax.outputs.overlay import OVERLAY_NAME, is_playable
from remind_jax.outputs.result import Result
from remind_jax.outputs.writer import render_again
from remind_jax.session.progress import Progress
from remind_jax.sources import LiveSource, Sampling
from remind_jax.sources.capture import Picture
from remind_jax.sources.live_source import LiveOptions, LiveReader
from remind_jax.sources.source import Content
from tests.cli import scenes
from tests.session.test_live import assert_same_answers
from tests.sources import cameras
from tests.sources.cameras import Camera

pytestmark = pytest.mark.heavy

OPTIONS = {"announce_after": 1, "overlay": False, "progress": False}


def run(camera: Camera, **options) -> Result:
    return rj.run(camera.url, **{"detector": cameras.detect, **OPTIONS, **options})


def own_ms(result: Result) -> np.ndarray:
    """What the tracker spent on each frame, without waiting for it."""
    stages = [times for name, times in result.timings_ms.items() if name not in ("age", "wait")]
    return np.sum(stages, axis=0)


def test_a_tracker_slower_than_the_stream_skips_and_never_lags():
    def slow(image):
        time.sleep(0.15)
        return cameras.detect(image)

    behind = []
    with Camera(fps=30) as camera:

        def follow(progress: Progress) -> None:
            behind.append(camera.num_sent)

        result = run(camera, detector=slow, sampling={"max_frames": 15}, progress=follow)
    ages_ms = np.array(result.timings_ms["age"])
    # A frame waits for the tracker at most until the next one comes.
    assert np.median(ages_ms / own_ms(result)) <= 1.5
    assert np.percentile(ages_ms / own_ms(result), 90) <= 2
    numbers = [tracks.source_index for tracks in result.tracks]
    gaps = np.diff(numbers) - 1
    assert np.median(gaps) >= 1
    assert result.summary()["skipped_frames"] == gaps.sum()
    assert result.skipped[0].reason == "a newer one was there when the tracker was ready"
    assert np.median(np.diff(behind)) >= 2  # the camera went on meanwhile


def test_room_is_made_for_what_is_found_in_the_first_picture():
    cells = np.kron(np.arange(1, 41).reshape(5, 8), np.ones((24, 24), int))

    def crowd(image):
        found = np.zeros(image.shape[:2], int)
        found[: cells.shape[0], : cells.shape[1]] = cells
        return found

    with Camera(fps=20) as camera:
        result = run(camera, detector=crowd, sampling={"max_frames": 3})
    assert len(result.tracks[0]) > 32  # more than there is room for by itself
    assert not result.grown_at


def test_identities_outlive_a_camera_that_drops_out(tmp_path):
    seen = []
    with Camera(fps=20) as camera:

        def follow(progress: Progress) -> None:
            seen.append(progress.num_done)
            if len(seen) == 5:
                camera.switch_off()
                threading.Timer(0.6, camera.switch_on).start()

        result = run(
            camera,
            sampling={"max_frames": 12},
            reconnect=60,
            progress=follow,
            out=tmp_path / "out",
        )
    assert result.complete
    assert {tuple(tracks.object_id) for tracks in result.tracks} == {(0, 1, 2)}
    (event,) = [event for event in Result.load(tmp_path / "out").events if event.kind == "source"]
    assert "was lost for" in event.message
    assert event.message.endswith("and came back")
    assert 0 < event.frame_index <= 6


def test_a_camera_that_stays_away_leaves_a_whole_folder(tmp_path, monkeypatch):
    with Camera(fps=20) as camera:
        cameras.patience_ends_with(camera, monkeypatch)

        def follow(progress: Progress) -> None:
            if progress.num_done == 4:
                camera.switch_off()

        with pytest.raises(SourceError, match="did not come back within 60 s"):
            run(camera, reconnect=60, progress=follow, out=tmp_path / "out")
    result = Result.load(tmp_path / "out")
    assert not result.complete
    assert len(result) >= 4
    assert (tmp_path / "out" / "report.html").is_file()
    assert (tmp_path / "out" / "memory.safetensors").is_file()


def test_a_recorded_run_is_repeated_with_equal_identities_and_drawn_again(tmp_path):
    out = tmp_path / "out"
    with Camera(fps=60) as camera:
        result = run(camera, sampling={"max_frames": 8}, out=out, record=tmp_path / "seen")
    assert result.tracks[-1].source_index > 7  # frames were passed over
    again = rj.run(tmp_path / "seen", detector=cameras.detect, delay=0, **OPTIONS)
    rows = tmp_path / "seen" / "detections.jsonl"
    by_masks = rj.run(tmp_path / "seen", masks=rows, delay=0, **OPTIONS)
    assert_same_answers(result.tracks, again.tracks)
    assert_same_answers(result.tracks, by_masks.tracks)
    (out / "report.html").unlink()
    drawn = render_again(out, rj.open_source(tmp_path / "seen"))
    assert_same_answers(result.tracks, drawn.tracks)
    assert (out / "report.html").is_file()
    assert (out / "overlay.mp4").is_file()


def test_a_camera_may_change_its_resolution(tmp_path):
    out, switched = tmp_path / "out", threading.Event()

    def make(number: int) -> bytes:
        image = cameras.shown_at(number)[0][..., ::-1]
        shown = image.repeat(2, 0).repeat(2, 1) if switched.is_set() else image
        return cv2.imencode(".jpg", shown, [cv2.IMWRITE_JPEG_QUALITY, 95])[1].tobytes()

    def detect(image: np.ndarray) -> dict[str, Any]:
        scale = image.shape[0] // scenes.HEIGHT_PX
        found = cameras.detect(image[::scale, ::scale])
        return {**found, "masks": found["masks"].repeat(scale, 1).repeat(scale, 2)}

    def follow(progress: Progress) -> None:
        if progress.num_done == 3:
            switched.set()

    options = {"out": out, "overlay": True, "record": tmp_path / "seen", "live": "127.0.0.1:0"}
    with Camera(fps=20, make=make) as camera:
        run(camera, detector=detect, sampling={"max_frames": 12}, progress=follow, **options)
    result = Result.load(out)
    sizes = [tracks.frame_size for tracks in result.tracks]
    assert (len(sizes), len({*sizes})) == (12, 2)
    assert all(len(tracks) for tracks in result.tracks)
    assert main(["view", str(out), "--source", str(tmp_path / "seen"), "--quiet"]) == 0
    assert is_playable(out / OVERLAY_NAME)


class Shrinking:
    """Pictures of which every second is too small for any object; each after a look at the last."""

    def __init__(self) -> None:
        self.sizes, self.looked_at = [(6, 8), (192, 256)] * 2, threading.Semaphore(1)

    def read(self) -> Picture | None:
        self.looked_at.acquire(timeout=100)
        return self._picture(self.sizes.pop(0)) if self.sizes else None

    def _picture(self, size: tuple[int, int]) -> Picture:
        first_look = iter([self.looked_at.release])  # the very first picture is looked at twice

        def look() -> Content:
            next(first_look, lambda: None)()
            return Content(np.zeros((*size, 3), np.uint8))

        return look

    def close(self) -> None:
        pass


def test_a_picture_that_is_too_small_is_left_out():
    reader = LiveReader("stream", "it", "it", lambda wait_s: Shrinking(), LiveOptions(reconnect=0))
    result = rj.run(
        LiveSource(reader, Sampling()), detector=lambda image: image[None, ..., 0] < 1, **OPTIONS
    )
    assert [tracks.frame_size for tracks in result.tracks] == [(192, 256)] * 2
    (left_out,) = [one for one in result.skipped if "8x6 pixels is smaller" in one.reason]
    assert left_out.count in (1, 2)  # the very first may be passed over


def test_ctrl_c_ends_a_live_run_well(tmp_path):
    with Camera(fps=30) as camera:

        def follow(progress: Progress) -> None:
            if progress.num_done == 3:
                raise KeyboardInterrupt

        result = run(camera, progress=follow, out=tmp_path / "out")
    assert result.complete
    assert len(result) == 3
    written = {path.name for path in (tmp_path / "out").iterdir()}
    assert {"run.json", "detections.jsonl", "report.html", "memory.safetensors"} <= written
    assert "checkpoint" not in written
    assert result.skipped == Result.load(tmp_path / "out").skipped


def test_a_live_run_is_not_gone_on_with(tmp_path):
    with Camera() as camera, pytest.raises(OutputError, match="is live and cannot be gone back in"):
        run(camera, out=tmp_path / "out", resume=True)


def test_a_record_cannot_begin_in_the_middle(tmp_path):
    with pytest.raises(OptionError, match="'record' would lack the frames before 'resume'"):
        rj.run("rooms.mp4", out=tmp_path, resume=True, record=tmp_path / "seen")


def test_no_password_is_stored_or_told(tmp_path, capfd):
    with Camera(fps=30, password="pa55word") as camera:
        result = rj.run(
            camera.url.replace("//", "//user:pa55word@") + "?token=pa55word",
            detector=cameras.detect,
            out=tmp_path / "out",
            record=tmp_path / "seen",
            live="127.0.0.1:0",
            **{**OPTIONS, "sampling": {"max_frames": 3}, "overlay": True},
        )
    assert "pa55word" not in f"{result} {result.info} {result.summary()} {capfd.readouterr()}"
    for path in tmp_path.rglob("*"):
        assert path.is_dir() or b"pa55word" not in path.read_bytes(), path
    assert result.info.source is not None
    assert result.info.source["address"].startswith("http://***@127.0.0.1:")


def test_the_page_shows_the_run_while_it_goes_on():
    states = []
    with Camera(fps=30) as camera:
        address = []

        def follow(progress: Progress) -> None:
            if progress.num_done in (2, 4):
                with urllib.request.urlopen(f"{address[0]}state.json", timeout=20) as answer:
                    states.append(json.load(answer))

        run(
            camera,
            sampling={"max_frames": 4},
            live="127.0.0.1:0",
            on_live=address.append,
            progress=follow,
        )
    assert [state["frames"] for state in states] == [2, 4]
    assert states[0]["source"] == "connected"
    assert states[0]["shown"] == camera.url
    assert {one["name"] for one in states[1]["in_view"]} == {"cup 0", "cup 1", "book 2"}
    with pytest.raises(OSError, match="refused"):
        urllib.request.urlopen(address[0], timeout=5)


def test_a_recorded_run_has_a_page_too(tmp_path, capsys):
    images, masks = scenes.write_scene(tmp_path / "scene")
    rj.run(images, masks=masks, live=True, **OPTIONS)
    assert "live page: http://127.0.0.1:" in capsys.readouterr().err


def test_the_loop_of_the_documentation_works(tmp_path, monkeypatch, capsys):
    page = (Path(__file__).parents[2] / "docs" / "live.md").read_text(encoding="utf-8")
    (loop,) = re.findall(r"```python\n(.*?)```", page, re.DOTALL)
    monkeypatch.chdir(tmp_path)
    with Camera(fps=10) as camera:
        loop = loop.replace("rtsp://10.0.0.5/main", camera.url).replace("3600", "1.5")
        exec(compile(loop, "live.md", "exec"), {})
    assert re.search(
        r"^0\.00 s, \d+\.\d\d s old: lamp new\?$", capsys.readouterr().out, re.MULTILINE
    )
    assert (tmp_path / "memory.safetensors").is_file()
