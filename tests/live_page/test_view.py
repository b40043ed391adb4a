"""What the live page is told, frame by frame."""

import dataclasses
import json
import threading

import cv2
import numpy as np
import pytest

from remind_jax.live_page import view as views
from remind_jax.live_page.view import LiveView
from remind_jax.outputs.run_records import Event, MemoryUse
from remind_jax.session.object_records import RememberedObject, Sight
from tests.outputs.fake_run import make_run


class Clock:
    now = 100.0

    def __call__(self) -> float:
        return self.now


@pytest.fixture(scope="module")
def run():
    return make_run(60, size=(120, 160))


@pytest.fixture
def view() -> LiveView:
    return LiveView("room", clock=Clock())


def show(view: LiveView, run, *positions: int, step_s: float = 0.1) -> None:
    frames, result = run
    for position in positions:
        frame = dataclasses.replace(frames[position], time_s=step_s * position)
        tracks = result.tracks[position]
        view.show(frame, tracks)


def test_nothing_is_there_before_the_first_frame():
    view = LiveView("room")
    state = view.state()
    assert (state["version"], state["frames"], state["in_view"]) == (0, 0, [])
    assert view.picture() is None
    json.dumps(state, allow_nan=False)


def test_who_is_in_view_and_who_is_remembered(view, run):
    show(view, run, *range(30))
    state, tracks = view.state(), run[1].tracks[29]
    assert [row["name"] for row in state["in_view"]] == [
        tracks.display_name(row) for row in range(len(tracks))
    ]
    firm = {tracks.display_name(row) for row in range(len(tracks)) if tracks.object_id[row] >= 0}
    known = {f"{one.label} {one.object_id}" for one in run[1].objects() if one.first_frame <= 29}
    remembered = {one["name"]: one for one in state["remembered"]}
    assert set(remembered) == known - firm
    gone = remembered["cup 1"]  # from frame 20 to 39
    assert gone["unseen_s"] == pytest.approx(1.0)
    assert state["num_objects"] == len(known)
    json.dumps(state, allow_nan=False)


def test_names_that_people_gave_are_shown(view, run):
    frame, tracks = run[0][25], dataclasses.replace(run[1].tracks[25], names={0: "my cup"})
    show(view, run, *range(25))
    view.show(frame, tracks)
    state = view.state()
    rows = [*state["remembered"], *state["timeline"]["rows"]]
    assert "my cup" in {row["name"] for row in rows}
    assert "cup 0" not in {row["name"] for row in rows}


def test_objects_of_earlier_runs_are_remembered(view, run):
    met, unseen = RememberedObject(0, "cup", "", 7, Sight(1, 0), Sight(1, 9)), 99
    away = dataclasses.replace(met, object_id=unseen, name="my hat", last=Sight(1, 8))
    view.remember([away, met])
    state = view.state()
    assert [one["name"] for one in state["remembered"]] == ["cup 0", "my hat"]
    assert (state["num_objects"], state["remembered"][0]["unseen_s"]) == (2, None)
    json.dumps(state, allow_nan=False)
    show(view, run, *range(60))
    state = view.state()
    assert state["num_objects"] == len(run[1].objects()) + 1
    assert f"hat {unseen}" not in {one["name"] for one in state["remembered"]}
    assert "cup 0" not in {one["name"] for one in state["remembered"] if one["unseen_s"] is None}


def test_what_the_memory_holds_is_told(view, run):
    show(view, run, 0)
    assert view.state()["memory"] is None
    frames, result = run
    view.show(frames[1], result.tracks[1], (), MemoryUse(300, 128, 172, 5_000_000))
    assert view.state()["memory"] == {
        "objects": 300, "working_set": 128, "at_rest": 172, "bytes": 5_000_000
    }  # fmt: skip


def test_an_absence_leaves_a_gap_in_the_timeline(view, run):
    show(view, run, *range(60))
    rows = {row["name"]: row["spans"] for row in view.state()["timeline"]["rows"]}
    assert len(rows["cup 0"]) == 1
    before, after = rows["cup 1"]
    assert before == (pytest.approx(before[0]), pytest.approx(1.9))
    assert after[0] >= 4.0


def test_the_timeline_ends_now_and_drops_what_is_long_ago(view, run):
    show(view, run, 0, step_s=0)
    frame, tracks = dataclasses.replace(run[0][0], time_s=1000.0), run[1].tracks[0]
    view.show(frame, tracks)
    timeline = view.state()["timeline"]
    assert (timeline["from_s"], timeline["to_s"]) == (1000.0 - views.WINDOW_S, 1000.0)
    assert all(span[1] == 1000.0 for row in timeline["rows"] for span in row["spans"])


def test_objects_that_turn_out_to_be_one_are_one(view, run):
    show(view, run, *range(10))
    tracks = run[1].tracks[10]
    ids = [int(i) for i in tracks.object_id if i >= 0]
    gone, kept = ids[1], ids[0]
    merged = dataclasses.replace(
        tracks, object_id=np.where(tracks.object_id == gone, kept, tracks.object_id)
    )
    view.show(run[0][10], merged, [Event(10, "merged", "they are one", (gone, kept))])
    names = [row["name"] for row in view.state()["timeline"]["rows"]]
    assert len(names) == len(set(names))
    assert not any(name.endswith(f" {gone}") for name in names)


def test_what_is_forgotten_leaves_the_page(view, run):
    view.remember([RememberedObject(99, "hat", "", 7, Sight(1, 0), Sight(1, 9))])
    show(view, run, *range(30))
    before = view.state()["num_objects"]
    view.show(run[0][30], run[1].tracks[30], [Event(30, "forgotten", "two are gone", (1, 99))])
    state = view.state()
    assert state["num_objects"] == before - 2
    assert not {"cup 1", "hat 99"} & {one["name"] for one in state["remembered"]}


def test_memory_is_bounded(view, run, monkeypatch):
    monkeypatch.setattr(views, "MAX_OBJECTS", 3)
    show(view, run, *range(60))
    assert view.state()["num_objects"] == 3


def test_the_picture_is_drawn_once_per_frame_and_only_if_asked_for(view, run, monkeypatch):
    drawn = []
    draw = views.draw_overlay

    def count(*args):
        drawn.append(1)
        return draw(*args)

    monkeypatch.setattr(views, "draw_overlay", count)
    show(view, run, *range(5))
    assert drawn == []
    first = view.picture()
    assert first is not None
    assert view.picture() is first
    show(view, run, 5)
    assert view.picture() != first
    assert len(drawn) == 2
    image = cv2.imdecode(np.frombuffer(first, np.uint8), cv2.IMREAD_COLOR)
    assert image is not None
    assert image.shape[:2] == (120, 160)


def test_large_frames_are_shown_smaller(view, run, monkeypatch):
    monkeypatch.setattr(views, "_MAX_SIDE_PX", 80)
    show(view, run, 0)
    image = cv2.imdecode(np.frombuffer(view.picture() or b"", np.uint8), cv2.IMREAD_COLOR)
    assert image is not None
    assert image.shape[:2] == (60, 80)


def test_every_object_gets_a_picture_in_time(view, run):
    show(view, run, *range(10))
    pictures = [view.picture_of(int(i)) for i in run[1].tracks[9].object_id if i >= 0]
    assert len(pictures) > 1
    assert all(pictures)
    assert view.picture_of(999) is None


def test_waiting_ends_with_news_or_with_time(view, run):
    threading.Timer(0.05, lambda: show(view, run, 0)).start()
    view.wait(0, 20.0)
    assert view.state()["version"] == 1
    view.wait(1, 0.01)
    view.end()
    view.wait(1, 20.0)
    assert view.state()["source"] == "ended"


def test_nobody_waits_for_a_picture_while_it_is_drawn(view, run, monkeypatch):
    """The tracker goes on while a thread of the page draws."""
    drawing, go = threading.Event(), threading.Event()

    def draw(image, tracks):
        drawing.set()
        assert go.wait(20)
        return image

    monkeypatch.setattr(views, "draw_overlay", draw)
    show(view, run, 0)
    thread = threading.Thread(target=view.picture)
    thread.start()
    assert drawing.wait(20)
    show(view, run, 1, 2)
    assert view.state()["frames"] == 3
    go.set()
    thread.join()
