"""What is told of objects: of those that became one, of other sessions, of what memory lost."""

import dataclasses

import numpy as np

import remind_jax as rj
from remind_jax.decision import NO_ID, Outcome
from remind_jax.session import identities
from remind_jax.session.announcement import Announcements
from remind_jax.session.identities import Identities
from remind_jax.session.memory_file import SavedMemory
from remind_jax.session.object_records import Sight
from remind_jax.tracks import Tracks
from tests.cli import scenes
from tests.session.test_object_records import seen

STATIC = {"num_detections": 4, "num_objects": 16}


def frame_of(index: int, *ids: int) -> Tracks:
    return seen(index, [*ids])


def never() -> set[int]:
    raise AssertionError("the memory was asked though little was told")


def test_objects_that_become_one_are_an_event_and_one_record():
    told = Identities(1, 0)
    told.add(frame_of(0, 4, 7), [], None, never)
    answers, events = told.add(frame_of(1, 4), [(7, 4)], None, never)
    (event,) = events
    assert (event.message, event.objects) == ("object 7 turned out to be object 4", (7, 4))
    assert answers.object_id.tolist() == [4]
    assert told.merges == [(7, 4)]
    assert [(one.object_id, one.num_frames) for one in told.records.objects()] == [(4, 2)]


def test_an_object_is_new_where_it_is_first_answered():
    """However long memory knew it before that."""
    for after, first in ((1, 0), (2, 1)):
        told = Identities(after, 0)
        answers = [told.add(frame_of(index, 4), [], None, never)[0] for index in range(4)]
        outcomes = [int(tracks.outcome[0]) for tracks in answers[first:]]
        assert outcomes == [Outcome.NEW, *[Outcome.MATCH] * (3 - first)]


def test_what_is_known_after_all_is_told_once_and_only_if_it_was_answered():
    told = Identities(1, 0)
    told.add(frame_of(0, 4, 7), [], None, never)
    for _ in range(2):
        _, events = told.add(frame_of(1, 4), [(7, 4), (9, 4)], None, never)
    assert events == []
    assert told.records.has(4)
    assert not told.records.has(7)


def test_records_agree_with_the_final_answers():
    """Object 4 gets its id in its second frame; of frame 2 it is known only later that it is 4."""
    told = Identities(2, 0)
    frames = [frame_of(0, 4), frame_of(1, 4), frame_of(2), frame_of(3, 4)]
    for decided in frames:
        told.add(decided, [], None, never)
    (known,) = told.records.objects()
    assert (known.num_frames, known.first) == (2, Sight(1, 1))
    run = told.conclude([*frames[:2], frame_of(2, 4), frames[3]])
    assert [tracks.object_id.tolist() for tracks in run] == [[0]] * 4
    (known,) = told.records.objects()
    assert (known.num_frames, known.first, known.last) == (4, Sight(1, 0), Sight(1, 3))


def test_what_was_taken_for_another_object_counts_in_the_end():
    """Objects 4 and 6 were seen three times and twice before they were found not to be object 0."""
    told = Identities(3, 0)
    seen = [frame_of(index, 0) for index in range(3)]
    for decided in [*seen, frame_of(3, 4), frame_of(4, 6)]:
        told.add(decided, [], None, never)
    assert told.announcements.waits(4)
    final = [*seen, *(frame_of(index, 4, 6) for index in (3, 4)), frame_of(5, 4)]
    run = told.conclude(final)
    assert [tracks.object_id.tolist() for tracks in run[2:]] == [[0], [1, NO_ID], [1, NO_ID], [1]]
    assert run[4].outcome[1] == Outcome.PROVISIONAL_NEW
    assert told.announcements.next_id == 2
    assert told.announcements.counts == {6: 1}
    _, late = told.records.objects()
    assert (late.object_id, late.num_frames, late.first, late.last) == (
        1,
        3,
        Sight(1, 3),
        Sight(1, 5),
    )


def test_what_earlier_sessions_counted_stays(tmp_path):
    config = {"tracker": "iou", "static": STATIC}
    tracker = rj.Tracker(config)
    scenes.follow(tracker, range(2))
    tracker.save(tmp_path / "memory.safetensors")
    again = rj.Tracker(config)
    again.load(tmp_path / "memory.safetensors")
    scenes.follow(again, range(2, 5))
    before = again.objects()
    told = again.identities
    assert told.decided is not None
    told.conclude([told.decided])  # of this session, one frame is left in the end
    for one, was in zip(again.objects(), before, strict=True):
        assert (one.num_frames, one.first, one.last) == (was.num_frames - 2, was.first, was.last)
    told.conclude([])
    assert again.objects() == tracker.objects(), "none was met again"


def test_an_id_that_people_chose_is_answered_when_the_tracker_finds_the_same():
    told = Identities(1, 0)
    told.add(frame_of(0, 4, 7, 9), [], None, never)
    told.records.merge(7, [4])
    for number, kept, merges in ((1, 4, [(7, 4)]), (2, 4, []), (3, 9, [(4, 9)]), (4, 9, [])):
        answers, events = told.add(frame_of(number, kept), merges, None, never)
        assert answers.object_id.tolist() == [7]
        assert [one.objects for one in events] == ([(9, 7)] if number == 3 else [])


def test_an_object_is_told_as_forgotten_with_the_last_that_people_merged_into_it():
    told = Identities(1, 0)
    told.add(frame_of(0, 4, 7, 9), [], None, never)
    told.records.merge(7, [4])
    assert told.tell_lost([7], 1, lambda: [4, 9]) == []
    (event,) = told.tell_excess([4, 5], 1, 1, lambda: [9])
    assert (event.message[:9], event.objects) == ("2 objects", (7,))
    (event,) = told.tell_lost([4], 1, lambda: [9])
    assert event.objects == (7,)
    assert told.tell_lost([5], 1, never) == []


def test_what_was_never_announced_becomes_another_in_silence():
    told = Identities(2, 0)
    told.add(frame_of(0, 4, 7), [], None, never)
    answers, events = told.add(frame_of(1, 4), [(7, 4)], None, never)
    assert events == []
    assert answers.object_id.tolist() == [0]


def restored(announce_after: int, announced: Announcements) -> Identities:
    """Those of a memory whose next object is number 6."""
    tracker = rj.Tracker({"tracker": "iou", "static": STATIC})
    tracker.update(*scenes.picture(0, (1, 2)))
    state = dataclasses.replace(tracker.state, next_id=np.int32(6))
    told = Identities(announce_after, 0)
    told.restore(SavedMemory(state, tracker.static, (), "none", "iou", announced))
    return told


def test_objects_of_a_memory_are_known_and_its_next_frame_begins_a_session():
    assert restored(1, Announcements()).announcements.is_identity
    late = restored(3, Announcements())
    assert late.announcements == Announcements.all_below(6)
    known = Announcements(0, {9: 0}, next_id=1)
    assert restored(3, known).announcements is known
    late.add(frame_of(7, 4), [], None, never)
    assert late.records.objects()[0].first == Sight(2, 7)


def test_a_run_that_goes_on_stays_in_its_session():
    told = restored(1, Announcements())
    told.resume({9: 4})
    told.add(frame_of(7, 4), [], None, never)
    assert told.records.objects()[0].first == Sight(1, 7)
    assert told.announcements.merged_into == {9: 4}


def test_records_of_what_memory_lost_do_not_pile_up(monkeypatch):
    monkeypatch.setattr(identities, "_FEW_TOLD", 4)
    told = Identities(1, 0)
    for index in range(5):  # things that are seen once, and one that stays
        told.add(frame_of(index, 1, 100 + index, 200 + index), [], None, lambda: {1})
        assert told.records.num_records <= 5
    assert 1 in [one.object_id for one in told.records.objects()]


def test_counts_of_what_memory_lost_do_not_pile_up():
    """Ids of false detections: each waits for more that never come."""
    tracker = rj.Tracker({"tracker": "iou", "static": STATIC}, announce_after=3)
    image, labels = scenes.picture(0, (1, 2))
    tracker.update(image, labels)
    told = tracker.identities
    lost = dict.fromkeys(range(1000, 2000), 1)
    before = told.announcements
    told.announcements = dataclasses.replace(before, counts={**before.counts, **lost})
    tracker.update(image, labels)
    assert told.announcements.counts == {0: 2, 1: 2}


def test_a_tracker_that_is_reset_knows_nobody():
    tracker = rj.Tracker({"tracker": "iou", "static": STATIC}, announce_after=2)
    scenes.follow(tracker, range(3), (1, 2))
    assert len(tracker.objects()) == 2
    tracker.reset()
    assert tracker.identities.decided is None
    assert tracker.identities.records.num_records == 0
    assert tracker.identities.announcements == Announcements.all_below(0)
