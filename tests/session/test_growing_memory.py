"""The memory on the device: growth changes no answer, an interruption loses none."""

import time

import numpy as np
import pytest

from remind_jax.compiled.frame_step import FrameStep
from remind_jax.errors import SourceError
from remind_jax.frame import Detections, Frame
from remind_jax.session import growing_memory
from remind_jax.session.live import Tracker
from tests.cli import scenes
from tests.session.test_live import CONFIG, assert_same_answers, frames


def things(index: int) -> tuple[np.ndarray, Detections]:
    """Two new objects every four frames, at places and of classes of their own."""
    image, masks, names = scenes.picture(0, ())[0], [], []
    for which in (0, 1):
        thing = 2 * (index // 4) + which
        rng = np.random.default_rng(thing)
        top, left = 16 + 80 * which, 16 + 72 * (thing // 2 % 3)
        window = np.s_[top : top + 64, left : left + 64]
        image[window] = np.kron(rng.integers(0, 255, (4, 4, 3)), np.ones((16, 16, 1)))
        masks.append(np.zeros(image.shape[:2], bool))
        masks[-1][window] = True
        names.append(str(1 + thing))
    return image, Detections.create(np.stack(masks), names)


def test_growth_ahead_and_growth_at_need_and_room_from_the_start_decide_the_same(
    looks_ahead, monkeypatch
):
    def follow(num_objects: int) -> tuple[Tracker, list]:
        static = {"num_detections": 4, "num_objects": num_objects, "num_pending": 4}
        tracker = Tracker({"tracker": "bank", "static": static})
        answers = []
        for index in range(16):
            answers.append(tracker.update(*things(index)))
            tracker._memory.ahead.finish()
        return tracker, answers

    ahead, prepared = follow(4)
    assert ahead.static.num_objects > 4
    with monkeypatch.context() as patched:
        patched.setattr(growing_memory.GrowingMemory, "_look_ahead", lambda *_: None)
        at_need, grown = follow(4)
    roomy, expected = follow(16)
    assert at_need.static.num_objects > 4
    assert roomy.static.num_objects == 16
    assert_same_answers(prepared, expected)
    assert_same_answers(grown, expected)


def crowd(index: int, others: int = 9) -> tuple[np.ndarray, Detections]:
    """Three objects, in the second frame among others, and these once more in the tenth."""
    image, labels = scenes.picture(0)
    masks = [*scenes.masks_of(labels)]
    for which in range(others * (index in (1, 9))):
        rng = np.random.default_rng(which)
        row, column = divmod(which, 18)
        window = np.s_[2 + 88 * row : 10 + 88 * row, 4 + 13 * column : 14 + 13 * column]
        image[window] = rng.integers(0, 255, 3)
        masks.append(np.zeros(labels.shape, bool))
        masks[-1][window] = True
    return image, Detections.create(np.stack(masks), [str(one) for one in range(len(masks))])


def test_room_for_a_crowd_goes_when_it_is_over_and_no_answer_changes(monkeypatch):
    monkeypatch.setattr(growing_memory, "UNUSED_FRAMES", 5)

    def follow() -> tuple[list, list[int]]:
        tracker, answers, room = Tracker(), [], []
        for index in range(12):
            answers.append(tracker.update(*crowd(index, others=36)))
            room.append(tracker.static.num_detections)
        return answers, room

    shrunk, room = follow()
    assert room == [32, 64, 64, 64, 64, 64, 32, 32, 32, 64, 64, 64]
    monkeypatch.setattr(growing_memory.GrowingMemory, "_shrink", lambda *_: None)
    expected, room = follow()
    assert room == [32, *[64] * 11]
    assert_same_answers(shrunk, expected)


def test_room_that_was_asked_for_stays(monkeypatch):
    monkeypatch.setattr(growing_memory, "UNUSED_FRAMES", 2)
    tracker = Tracker()
    tracker.warm_up((scenes.HEIGHT_PX, scenes.WIDTH_PX), num_detections=64)
    for index in (0, 2, 3):
        tracker.update(*crowd(index))
    assert tracker.static.num_detections == 64
    tracker.reset()
    assert tracker.static.num_detections == 64


@pytest.mark.parametrize(("expected", "is_prepared"), [(12, False), (11, True)])
def test_what_room_was_made_for_is_no_reason_to_prepare_more(
    expected, is_prepared, looks_ahead, monkeypatch
):
    static = {"num_detections": 4, "num_objects": 64}
    tracker, prepared = Tracker({"tracker": "bank", "static": static}), []
    tracker.warm_up((scenes.HEIGHT_PX, scenes.WIDTH_PX), num_detections=expected)
    monkeypatch.setattr(tracker._memory.ahead, "start", lambda static, _: prepared.append(static))
    for index in (0, 1):
        tracker.update(*crowd(index))
    assert tracker.static.num_detections == 16
    assert bool(prepared) == is_prepared


def test_after_a_warm_up_for_so_many_objects_nothing_more_is_compiled(looks_ahead, monkeypatch):
    static = {"num_detections": 4, "num_objects": 4, "num_pending": 4}
    tracker = Tracker({"tracker": "bank", "static": static})
    tracker.warm_up((scenes.HEIGHT_PX, scenes.WIDTH_PX), num_objects=8)
    prepared = tracker._memory.frame_step.programs()
    monkeypatch.setattr(tracker._memory, "_prepare", None)  # nothing is asked for
    for image, labels in frames(2):
        tracker.update(image, labels)
    assert tracker.static.num_objects == 8
    assert tracker._memory.frame_step.programs() == prepared
    assert tracker.compile_s == 0.0


def test_a_start_below_what_the_first_frame_needs_begins_with_that():
    static = {"num_detections": 1, "num_objects": 1, "num_pending": 4}
    tracker = Tracker({"tracker": "bank", "static": static})
    for image, labels in frames(2):
        tracker.update(image, labels)
    assert (tracker.static.num_detections, tracker.static.num_objects) == (4, 8)
    assert len(tracker._memory.frame_step.programs()) == 2  # describes, decides


@pytest.mark.parametrize("is_waited_for", [False, True])
def test_interruption_within_a_step_leaves_the_memory_whole(is_waited_for, monkeypatch, tmp_path):
    tracker = Tracker(CONFIG)
    first, second, third = frames(3)
    tracker.update(*first)

    decide = FrameStep.decide

    def interrupt(*given):
        if not is_waited_for:
            decide(*given)
        raise KeyboardInterrupt

    with monkeypatch.context() as patched:
        where = (growing_memory.jax, "device_get") if is_waited_for else (FrameStep, "decide")
        patched.setattr(*where, interrupt)
        with pytest.raises(KeyboardInterrupt):
            tracker.update(*second)
    tracker.save(tmp_path / "memory.safetensors")
    other = Tracker(CONFIG)
    other.load(tmp_path / "memory.safetensors")
    assert int(other.state.frame) == int(tracker.state.frame) == 1 + is_waited_for
    ours, expected = other.update(*third), tracker.update(*third)
    assert_same_answers([ours], [expected])
    assert set(ours.object_id) == {0, 1, 2}


def test_features_of_another_width_are_refused():
    tracker = Tracker(CONFIG)
    image, labels = frames(1)[0]
    tracker.update(image, labels)
    grid = (scenes.HEIGHT_PX // scenes.PATCH_PX, scenes.WIDTH_PX // scenes.PATCH_PX)
    frame, wider = (
        Frame(1, 1, 1.0, "1", image, features=np.zeros((*grid, width), np.float32))
        for width in (7, 8)
    )
    with pytest.raises(SourceError, match="brings its own features, the memory was made with"):
        tracker.update(frame, labels)
    tracker.reset()
    tracker.update(frame, labels)
    with pytest.raises(SourceError, match=r"features of 8 numbers.*the memory knows"):
        tracker.update(wider, labels)
    with pytest.raises(SourceError, match="brings none of its own"):
        tracker.update(image, labels)


def test_a_frame_that_waits_for_room_in_preparation_tells_so(looks_ahead, monkeypatch):
    def prepare(memory, make_input, static):
        time.sleep(1.0)  # a compiler that is late

    static = {"num_detections": 4, "num_objects": 4, "num_pending": 4}
    tracker = Tracker({"tracker": "bank", "static": static})
    tracker.warm_up((scenes.HEIGHT_PX, scenes.WIDTH_PX), num_objects=8)
    monkeypatch.setattr(growing_memory.GrowingMemory, "_prepare", prepare)
    for index in range(16):
        tracker.update(*things(index))
        if tracker.has_grown:
            break
    assert tracker.compile_s > 0.1
