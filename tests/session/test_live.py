"""The live tracker: one compilation, warm-ups, and choices that are refused."""

import contextlib
import threading
from collections.abc import Iterable

import jax
import numpy as np
import pytest

from remind_jax.errors import ConfigError, OutputError, RemindError, SourceError
from remind_jax.frame import Detections, Frame
from remind_jax.session import memory_file
from remind_jax.session.live import Tracker
from remind_jax.session.memory_file import load_memory
from remind_jax.session.memory_parts import read_parts
from remind_jax.session.object_records import ObjectRecords
from remind_jax.tracks import Tracks
from tests.cli import scenes

# Of a tracker that compiles quickly: what is asked here does not depend on who decides.
CONFIG = {
    "tracker": "bank",
    "static": {"num_detections": 4, "num_objects": 8, "num_pending": 4},
}


def frames(num: int) -> list[tuple[np.ndarray, np.ndarray]]:
    return [scenes.picture(index) for index in range(num)]


def assert_same_answers(ours: Iterable[Tracks], theirs: Iterable[Tracks]) -> None:
    """Who is who, what was decided, and how sure that is, frame by frame."""
    for one, other in zip(ours, theirs, strict=True):
        for name in ("object_id", "outcome", "score", "confidence", "candidate_id", "boxes"):
            np.testing.assert_array_equal(getattr(one, name), getattr(other, name), name)


def frame_of_features() -> Frame:
    """One object, and features that are no backbone's."""
    features = np.random.default_rng(0).normal(size=(6, 8, 7)).astype(np.float32)
    masks = np.zeros((1, 96, 128), bool)
    masks[0, 32:64, 32:64] = True
    return Frame(0, 0, 0.0, "0", None, Detections.create(masks), features)


@pytest.mark.slow
def test_one_compilation_whatever_the_counts():
    # A capacity that no other test uses: nothing is compiled yet.
    tracker = Tracker({"tracker": "plus", "static": {**CONFIG["static"], "num_objects": 13}})
    for index, ids in enumerate([(1, 2, 3), (1, 2, 3), (1,), (), (1, 2, 3, 4)]):
        tracker.update(*scenes.picture(index, ids))
    assert len(tracker._memory.frame_step.programs()) == 2  # describes, decides


def test_a_warm_up_makes_room_for_a_crowd():
    tracker = Tracker(CONFIG)
    tracker.warm_up((scenes.HEIGHT_PX, scenes.WIDTH_PX), num_detections=5)
    assert tracker.static.num_detections == 8
    tracker.update(*frames(1)[0])
    assert tracker.compile_s == 0.0
    tracker.warm_up((scenes.HEIGHT_PX, scenes.WIDTH_PX), num_detections=3)
    assert tracker.static.num_detections == 8


def test_a_warm_up_changes_no_answer():
    plain, warm = Tracker(CONFIG), Tracker(CONFIG)
    warm.update(*frames(1)[0])
    warm.warm_up((scenes.HEIGHT_PX, scenes.WIDTH_PX))
    plain.update(*frames(1)[0])
    assert_same_answers(*(scenes.follow(tracker, (1, 2)) for tracker in (plain, warm)))


def test_time_spent_on_programs_is_reported():
    # A capacity that no other test uses: nothing is compiled yet.
    tracker = Tracker({**CONFIG, "static": {**CONFIG["static"], "num_objects": 7}})
    tracker.update(*frames(1)[0])
    first = tracker.compile_s
    tracker.update(*frames(2)[1])
    assert tracker.compile_s == first > 0.0


def test_a_switch_that_the_method_does_not_have_is_refused():
    with pytest.raises(ConfigError, match=r"'static\.part_clusters' .* switch of tracker 'remind'"):
        Tracker({"tracker": "plus", "static": {"part_clusters": 6}})
    chosen = {"tracker": "remind", "static": {"part_clusters": 6}}
    assert Tracker(chosen).static.switches.part_clusters == 6
    assert Tracker({"tracker": "plus", "static": {"num_candidates": 3}}).static.num_candidates == 3


def test_nothing_of_the_stream_before_is_left_after_load_and_reset(tmp_path):
    path = tmp_path / "memory.safetensors"
    tracker = Tracker({"tracker": "plus"})
    for image, labels in frames(2):
        tracker.update(image, labels)
    tracker.save(path)
    tracker.load(path)
    assert tracker.preparer.last_image is None
    kept = tmp_path / "kept"
    tracker.checkpoint(kept)
    tracker.reset()
    tracker.update(*frames(1)[0])
    tracker.checkpoint(kept)  # not what changed since the memory that is gone
    assert len(read_parts(kept)) == 1
    tracker.reset()
    tracker.update(frame_of_features())
    tracker.reset()
    tracker.update(*frames(1)[0])
    tracker.save(path)
    assert load_memory(path).backbone == tracker.features.described_by


def test_a_memory_is_saved_where_a_link_leads(tmp_path):
    tracker, link = Tracker(), tmp_path / "link"
    tracker.update(*scenes.picture(0))
    link.symlink_to(tmp_path / "memory")
    tracker.save(link)
    assert link.is_symlink()
    assert Tracker(memory=tmp_path / "memory").num_objects == tracker.num_objects


def test_a_camera_may_give_one_buffer_again_and_again():
    own, shared = Tracker({"tracker": "plus"}), Tracker({"tracker": "plus"})
    buffer = np.empty_like(frames(1)[0][0])
    for image, labels in frames(3):
        buffer[:] = image
        own.update(image, labels)
        tracks = shared.update(buffer, labels)
    assert tracks.time_s == 0.2  # the third of ten a second, where no clock tells
    for left, right in zip(*map(jax.tree.leaves, (own.state, shared.state)), strict=True):
        np.testing.assert_array_equal(left, right)
    with pytest.raises(SourceError, match="time_s of a frame is 1000"):
        own.update(image, labels, time_s=10**400)
    for clock in (np.array(1.0), jax.numpy.float32(1.5)):
        assert own.update(image, labels, time_s=clock).time_s == float(clock)


def test_a_memory_that_is_refused_changes_nothing(tmp_path):
    given = Tracker(CONFIG)
    given.update(frame_of_features())
    given.save(tmp_path / "given")
    tracker = Tracker({**CONFIG, "static": {**CONFIG["static"], "first_object_id": 1}})
    assert min(tracker.update(*frames(1)[0]).object_id) == 1
    with pytest.raises(RemindError, match="first_object_id"):
        tracker.load(tmp_path / "given")
    tracker.save(tmp_path / "own")
    assert load_memory(tmp_path / "own").backbone == tracker.features.described_by


def test_what_another_program_wrote_is_not_overwritten(tmp_path):
    tracker, other = Tracker(CONFIG), Tracker(CONFIG)
    kept = tmp_path / "kept.safetensors"
    tracker.update(*frames(1)[0])
    tracker.checkpoint(kept)
    other.load(kept)
    other.rename(0, "precious")
    other.save(kept)
    for _ in range(2):
        with pytest.raises(OutputError, match="changed by another program"):
            tracker.checkpoint(kept)
    tracker.load(kept)
    tracker.checkpoint(kept)
    tracker.save(kept)  # by itself
    tracker.checkpoint(kept)
    other.load(kept)
    assert other.objects()[0].name == "precious"


@pytest.mark.parametrize("name", ["save_memory", "_identity"])
def test_what_ctrl_c_cut_off_is_not_another_program(tmp_path, monkeypatch, name):
    tracker, kept = Tracker(CONFIG), tmp_path / "kept.safetensors"
    tracker.update(*frames(1)[0])
    tracker.save(kept)
    change = getattr(memory_file, name)
    for write in (tracker.checkpoint, tracker.save):
        calls = []

        def stop(*given, calls=calls, **options):
            calls.append(change(*given, **options))
            if name == "save_memory" or len(calls) > 1:
                raise KeyboardInterrupt
            return calls[0]

        tracker.load(kept)
        with monkeypatch.context() as patched:
            patched.setattr(memory_file, name, stop)
            with contextlib.suppress(KeyboardInterrupt):
                write(kept)
        tracker.checkpoint(kept)


def test_a_join_that_ctrl_c_cuts_off_changes_nothing(tmp_path, monkeypatch):
    tracker, other = Tracker(), Tracker()
    scenes.follow(tracker, range(6), (1, 2))
    scenes.follow(other, range(6), (3, 4))
    other.save(tmp_path / "other")
    before, ids = tracker.objects(), tracker._memory.at_rest.ids()

    def stop(*_):
        raise KeyboardInterrupt

    with monkeypatch.context() as patched:
        patched.setattr(ObjectRecords, "unite", stop)
        with pytest.raises(KeyboardInterrupt):
            tracker.join(tmp_path / "other")
    assert (tracker.objects(), tracker._memory.at_rest.ids()) == (before, ids)
    assert len(tracker.join(tmp_path / "other").ids) == 2


def test_a_frame_that_was_prepared_before_a_reset_is_refused():
    tracker = Tracker(CONFIG)
    frame = frame_of_features()
    prepared = tracker.prepare(frame)
    tracker.reset()
    with pytest.raises(SourceError, match="prepared before 'reset'"):
        tracker.advance(prepared)
    with pytest.raises(SourceError, match="by another Tracker"):
        tracker.advance(Tracker(CONFIG).prepare(frame))
    tracker.advance(tracker.prepare(frame))


def test_what_is_refused_for_a_second_thread_changes_nothing():
    tracker = Tracker(CONFIG)
    tracker.update(*frames(1)[0])
    known, begun, done = tracker.class_names, threading.Event(), threading.Event()

    def advance():
        with tracker._alone("advance"):
            begun.set()
            done.wait()

    thread = threading.Thread(target=advance)
    thread.start()
    begun.wait()
    image, masks = frames(1)[0]
    for use in (
        lambda: tracker.update(image, {"masks": masks == 1, "labels": ["other"]}, time_s=99.0),
        lambda: tracker.warm_up((96, 128), num_detections=9),
        lambda: tracker.state,
        lambda: repr(tracker),
    ):
        with pytest.raises(RemindError, match="two threads"):
            use()
    done.set()
    thread.join()
    assert (tracker.class_names, tracker.preparer.last_time_s) == (known, None)
    assert tracker.static.num_detections == 4


def test_a_path_that_leads_nowhere_is_refused(tmp_path):
    tracker, loop = Tracker(CONFIG), tmp_path / "loop.safetensors"
    loop.symlink_to(loop)
    tracker.update(*frames(1)[0])
    for use in (tracker.load, tracker.save, tracker.checkpoint):
        with pytest.raises(OutputError, match=r"'.*loop\.safetensors' cannot be used"):
            use(loop)


def test_what_another_program_wrote_is_kept_beside_other_files(tmp_path):
    tracker, other = Tracker(CONFIG), Tracker(CONFIG)
    kept, second = tmp_path / "kept.safetensors", tmp_path / "second.safetensors"
    tracker.update(*frames(1)[0])
    tracker.checkpoint(kept)
    tracker.load(kept)
    tracker.checkpoint(second)
    tracker.save(kept)
    other.load(kept)
    other.rename(0, "precious")
    other.save(kept)
    for forget in (lambda: tracker.load(second), tracker.reset):
        with pytest.raises(OutputError, match="changed by another program"):
            tracker.checkpoint(kept)
        forget()
        tracker.update(*frames(1)[0])
        with pytest.raises(OutputError, match="changed by another program"):
            tracker.checkpoint(kept)
    tracker.update(*frames(2)[1])
    for _ in range(2):
        tracker.checkpoint(second)
    other.load(second)
    assert other.objects() == tracker.objects()


def test_room_that_was_asked_for_stays_when_a_memory_is_loaded(tmp_path):
    tracker, small = Tracker(CONFIG), Tracker(CONFIG)
    small.update(*frames(1)[0])
    small.save(tmp_path / "small")
    tracker.warm_up((scenes.HEIGHT_PX, scenes.WIDTH_PX), num_detections=5)
    tracker.load(tmp_path / "small")
    assert (tracker.static.num_detections, small.static.num_detections) == (8, 4)
    assert_same_answers(*(scenes.follow(one, (1, 2)) for one in (tracker, small)))


def test_a_name_is_free_once_its_object_is_forgotten(tmp_path):
    first, second = Tracker({"input": {"max_objects": 3}}), Tracker()
    scenes.follow(first, range(6), (1, 2, 3))
    first.rename(0, "mine")
    scenes.follow(first, range(6, 30), (2, 3, 4))
    assert first.num_objects == 3
    scenes.follow(second, range(6), (1, 2, 3))
    second.rename(0, "mine")
    second.save(tmp_path / "second")
    joined = first.join(tmp_path / "second")
    assert {one.object_id for one in first.objects() if one.name == "mine"} == {joined.ids[0]}


@pytest.mark.parametrize("first", [False, True])
def test_a_memory_with_classes_is_refused_where_none_are_compared(first, tmp_path):
    trackers = [
        Tracker({**CONFIG, "input": {"class_agnostic": agnostic}})
        for agnostic in (first, not first)
    ]
    trackers[0].update(*frames(1)[0])
    trackers[0].save(tmp_path / "kept.safetensors")
    with pytest.raises(RemindError, match="class_agnostic"):
        trackers[1].load(tmp_path / "kept.safetensors")
    trackers[1].update(*frames(1)[0])
    with pytest.raises(RemindError, match="classes; join memories made with"):
        trackers[1].join(tmp_path / "kept.safetensors")


def test_a_class_may_have_the_name_that_stands_for_any(tmp_path):
    image, masks = frames(1)[0]
    trackers = [Tracker(CONFIG), Tracker(), Tracker()]
    for tracker, label in zip(trackers, ("thing", "thing", "mug"), strict=True):
        for _ in range(4):
            tracker.update(image, {"masks": masks == 1, "labels": [label]})
        tracker.save(tmp_path / label)
        again = Tracker(tracker.config)
        again.load(tmp_path / label)
        assert [one.title for one in again.objects()] == [f"{label} 0"]
    trackers[1].join(tmp_path / "mug")
    assert len(trackers[1].objects()) == 2


def test_classes_are_told_where_none_are_compared():
    tracker = Tracker({**CONFIG, "input": {"class_agnostic": True}})
    image, masks = frames(1)[0]
    for label in ("mug", "cup", "mug"):
        tracks = tracker.update(image, {"masks": masks == 1, "labels": [label]})
        assert tracks.labels == (label,)
    assert tracker.class_names == ("mug", "cup")


def test_frames_of_a_source_that_is_opened_again_are_later_ones():
    tracker = Tracker(CONFIG)
    for _ in range(2):
        for index, (image, labels) in enumerate(frames(3)):
            frame = Frame(index, index, index / 10, "again", image, None)
            tracker.update(frame, labels)
    assert {(one.last.frame, one.num_frames) for one in tracker.objects()} == {(5, 6)}
