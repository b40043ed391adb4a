"""Records of objects: what is noted, said by people, written and read back."""

import dataclasses
import json

import numpy as np
import pytest

import remind_jax as rj
from remind_jax.decision import NO_ID, Outcome, Reason
from remind_jax.errors import OutputError, SourceError
from remind_jax.files.tensors import read_safetensors_header
from remind_jax.frame import Detections
from remind_jax.method import list_methods
from remind_jax.session.answers import as_merged
from remind_jax.session.filed_records import from_file, to_file
from remind_jax.session.live import Tracker
from remind_jax.session.memory_file import load_memory
from remind_jax.session.object_pictures import Picture, Pictures, best_of, fit_into
from remind_jax.session.object_records import ObjectRecords, Sight
from remind_jax.tracks import Tracks
from tests.cli import scenes
from tests.outputs import fake_run
from tests.session.test_memory_file import rewrite

FRAMES = 12


def seen(number: int, ids: list[int]) -> Tracks:
    """Answers about a frame with these objects in it."""
    masks = np.zeros((len(ids), 48, 64), bool)
    for place in range(len(ids)):
        masks[place, 10:30, 5 + 20 * place : 20 + 20 * place] = True
    return fake_run.make_tracks(number, masks, [{"object_id": one, "label": "cup"} for one in ids])


@pytest.fixture(scope="module")
def saved(tmp_path_factory):
    """A memory of three objects."""
    tracker = Tracker()
    scenes.follow(tracker, range(FRAMES))
    path = tmp_path_factory.mktemp("memory") / "memory.safetensors"
    tracker.save(path)
    return path


@pytest.fixture
def tracker(saved) -> Tracker:
    tracker = Tracker()
    tracker.load(saved)
    return tracker


def look(tracker: Tracker):
    return tracker.update(*scenes.picture(FRAMES))


def test_objects_are_listed(tracker):
    objects = tracker.objects()
    assert [one.object_id for one in objects] == [0, 1, 2]
    assert [one.title for one in objects] == ["object 0", "object 1", "object 2"]
    assert {one.num_frames for one in objects} == {FRAMES}
    assert {(one.first, one.last) for one in objects} == {(Sight(1, 0), Sight(1, FRAMES - 1))}
    for one in objects:
        assert 1 <= len(one.pictures) <= 3
        assert all(jpeg.startswith(b"\xff\xd8\xff") for jpeg in one.pictures)


def test_names_are_shown_and_kept(tracker, tmp_path):
    tracker.rename(1, " my mug ")
    assert look(tracker).display_name(1) == "my mug"
    tracker.save(tmp_path / "named")
    other = Tracker()
    other.load(tmp_path / "named")
    tracks = look(other)
    assert [tracks.display_name(row) for row in range(3)] == ["object 0", "my mug", "object 2"]
    other.rename(1, "")
    assert look(other).display_name(1) == "object 1"
    assert tracks.display_name(1) == "my mug"  # an answer that was given stays


def test_records_of_a_joined_memory_follow_and_begin_a_session(tracker, tmp_path):
    tracker.rename(1, "my mug")
    tracker.merge(0, 2)
    tracker.save(tmp_path / "other")
    other = Tracker()
    scenes.follow(other, range(1, FRAMES + 1))
    other.rename(2, "spoon")
    found = other.join(tmp_path / "other")
    new = [found.ids[one] for one in (0, 1, 2)]
    # Object 2 there was merged into object 0 there, which is object 0 here.
    assert sorted(found.matched) == [(0, new[0]), (1, new[1])]
    assert found.num_added == 3
    first, second, third = other.objects()
    assert (first.merged, second.merged, third.merged) == ((new[0], new[2]), (new[1],), ())
    assert (second.name, third.name) == ("my mug", "spoon")
    assert {(one.first, one.last) for one in (first, second)} == {
        (Sight(1, 0), Sight(2, FRAMES - 1))
    }
    assert second.num_frames == 2 * FRAMES
    look(other)
    assert other.objects()[0].last == Sight(3, FRAMES)


def test_only_what_has_an_id_is_told_as_joined(tracker, tmp_path):
    tracker.identities.records._records.pop(2)  # as of what was never answered
    tracker.save(tmp_path / "other")
    joined = Tracker()
    scenes.follow(joined, range(1))
    found = joined.join(tmp_path / "other")
    assert set(found.ids) == {0, 1}
    assert found.num_added == 2
    assert all(map(joined.identities.records.has, found.ids.values()))


def test_what_cannot_be_done_is_refused(tracker):
    for name in ("a\nb", "\x1b[31m", "x" * 201, 3, None):
        with pytest.raises(SourceError, match="cannot be called"):
            tracker.rename(0, name)
    for ids in ((0,), (0, 0), (0, 1, 1)):
        with pytest.raises(SourceError, match="cannot be merged"):
            tracker.merge(*ids)
    for object_id in (7, -1, "0", 0.5, True, None):
        for call in (
            lambda one: tracker.rename(one, "mug"),
            lambda one: tracker.merge(one, 1),
            lambda one: tracker.merge(1, one),
            tracker.split,
            tracker.forget,
        ):
            with pytest.raises(SourceError, match=r"there is no object .*; known: 0, 1, 2"):
                call(object_id)


def test_two_objects_of_one_name_are_refused(tracker):
    tracker.rename(0, "mug")
    with pytest.raises(SourceError, match="object 0 is called 'mug' already"):
        tracker.rename(1, "mug")
    tracker.rename(0, "mug")  # itself is no other
    with pytest.raises(SourceError, match="object 2 is shown as 'object 2'; give another"):
        tracker.rename(1, "object 2")
    tracker.rename(1, "object 1")


def test_a_name_that_another_object_is_shown_by_later_is_read_back(tracker, tmp_path):
    tracker.merge(1, 0)
    tracker.rename(2, "object 0")
    tracker.split(1)
    tracker.save(tmp_path / "memory")
    again = Tracker()
    again.load(tmp_path / "memory")
    assert again.objects() == tracker.objects()


def test_of_two_options_that_were_merged_one_is_left():
    """Another detection that had one option only stays what it was."""
    doubt = {"outcome": Outcome.AMBIGUOUS, "reason": Reason.KNOWN_BUT_AMBIGUOUS, "label": "cup"}
    options = ([(1, 0.5), (2, 0.4)], [(1, 0.5)], [(1, 0.5), (3, 0.4)])
    rows = [{**doubt, "candidates": candidates} for candidates in options]
    tracks = as_merged(fake_run.make_tracks(0, np.ones((3, 4, 4), bool), rows), {2: 1})
    assert tracks.outcome.tolist() == [
        Outcome.PROVISIONAL_PARENT, Outcome.AMBIGUOUS, Outcome.AMBIGUOUS
    ]  # fmt: skip
    assert tracks.reason.tolist() == [
        Reason.UNCERTAIN_PARENT, Reason.KNOWN_BUT_AMBIGUOUS, Reason.KNOWN_BUT_AMBIGUOUS
    ]  # fmt: skip


def test_merged_objects_have_one_id_until_they_are_split(tracker, tmp_path):
    tracker.rename(2, "spoon")
    tracker.merge(0, 2)
    tracks = look(tracker)
    assert sorted(tracks.object_id.tolist()) == [NO_ID, 0, 1]  # both are in view
    (lost,) = np.flatnonzero(tracks.object_id == NO_ID)
    assert tracks.outcome[lost] == Outcome.AMBIGUOUS
    assert tracks.candidate_id[lost, 0] == 0
    known = tracker.objects()
    assert [(one.object_id, one.name, one.merged) for one in known] == [
        (0, "spoon", (2,)),
        (1, "", ()),
    ]
    assert known[0].num_frames == 2 * FRAMES + 1  # a frame since then counts once
    with pytest.raises(SourceError, match="object 2 was merged into object 0"):
        tracker.rename(2, "fork")
    tracker.save(tmp_path / "merged")
    tracker.load(tmp_path / "merged")
    assert tracker.split(0) == (2,)
    assert [one.name for one in tracker.objects()] == ["", "", "spoon"]
    assert look(tracker).object_id.tolist() == [0, 1, 2]
    with pytest.raises(SourceError, match="nothing was merged into object 0"):
        tracker.split(0)


@pytest.mark.parametrize(
    "method",
    [pytest.param(m, marks=[pytest.mark.slow] if m == "remind" else []) for m in list_methods()],
)
def test_what_is_forgotten_is_new_when_seen_again(method):
    tracker = Tracker(tracker=method)
    known = scenes.follow(tracker, range(FRAMES))[-1].object_id.tolist()
    assert len(set(known)) == 3
    tracker.forget(known[1])
    assert [one.object_id for one in tracker.objects()] == [known[0], known[2]]
    assert known[1] not in np.asarray(tracker.state.objects.id)
    after = scenes.follow(tracker, range(FRAMES, FRAMES + 3))[-1].object_id.tolist()
    assert (after[0], after[2]) == (known[0], known[2])
    assert after[1] not in known


def test_what_turned_out_in_an_earlier_frame_is_not_told_again():
    """Its record is still there if people chose its id for another object."""
    tracker = Tracker()
    merges = dataclasses.replace(tracker.method.host, merges=lambda _: [(99, 0)])
    tracker.method = dataclasses.replace(tracker.method, host=merges)
    for index in range(3):
        tracker.update(*scenes.picture(index))
        assert tracker.events == []
        tracker.identities.records.note(seen(index, [99]), None)


def test_what_was_seen_too_briefly_is_told_and_its_name_is_free():
    tracker = Tracker()
    tracker.update(*scenes.picture(0))
    tracker.rename(2, "mug")
    events = []
    for index in range(1, FRAMES):
        tracker.update(*scenes.picture(index, (1, 2)))
        events += tracker.events
    assert [one.kind for one in events] == ["forgotten"]
    assert events[0].message.startswith("object 2 forgotten")
    assert events[0].objects == (2,)
    tracker.rename(0, "mug")
    with pytest.raises(SourceError, match="there is no object 2; known: 0, 1"):
        tracker.rename(2, "spoon")


def test_nothing_of_the_looks_of_a_forgotten_object_is_left(tracker):
    objects = tracker.state.objects
    slot = int(np.flatnonzero(np.asarray(objects.id) == 1)[0])
    assert np.any(np.asarray(objects.bank)[slot])
    tracker.forget(1)
    assert not np.any(np.asarray(tracker.state.objects.bank)[slot])
    assert 1 not in {one.object_id for one in tracker.objects()}


def test_merged_objects_are_forgotten_together(tracker):
    tracker.merge(0, 2)
    tracker.forget(0)
    assert [one.object_id for one in tracker.objects()] == [1]
    assert set(np.asarray(tracker.state.objects.id)) == {NO_ID, 1}


def test_pictures_can_be_left_out():
    tracker = Tracker({"input": {"keep_pictures": False}})
    tracker.update(*scenes.picture(0))
    assert [one.pictures for one in tracker.objects()] == [()] * 3


def test_what_the_tracker_found_to_be_one_is_one_record():
    records = ObjectRecords()
    for number, ids in enumerate([[0], [0, 1], [1, 2]]):
        records.note(seen(number, ids), None)
    records.rename(1, "mug")
    records.merge(1, [2])
    records.merge_for_good(1, 0)
    (known,) = records.objects()
    assert (known.object_id, known.name, known.num_frames, known.merged) == (1, "mug", 3, (0, 2))
    assert (known.first, known.last) == (Sight(1, 0), Sight(1, 2))


def test_what_people_and_tracker_found_alike_stays_one():
    records = ObjectRecords()
    records.note(seen(0, [0, 1]), None)
    records.merge(1, [0])
    records.merge_for_good(1, 0)
    assert [(one.object_id, one.merged) for one in records.objects()] == [(1, (0,))]
    records.merge_for_good(0, 1)
    assert [(one.object_id, one.merged) for one in records.objects()] == [(1, ())]


def test_a_frame_of_both_counts_once_after_they_were_seen_apart():
    records = ObjectRecords()
    for number, ids in ((0, [0]), (4, [1])):
        records.note(seen(number, ids), None)
    records.merge(0, [1])
    run = [seen(8, [0, 1])]
    records.note(run[0], None)
    assert records.objects()[0].num_frames == 3
    records.session += 1
    for number in (3, 8):
        records.note(seen(number, [0, 1]), None)
    records.recount(run)
    assert records.objects()[0].num_frames == 4


def test_what_later_frames_took_from_an_object_is_not_told_of_it():
    records = ObjectRecords()
    for number in range(2):
        records.note(seen(number, [0, 1]), None)
    records.note(dataclasses.replace(seen(2, [2]), labels=("sink",)), None)  # announced now
    records.note(seen(3, [3, 4]), None)
    records.merge(4, [3])
    records.recount([seen(0, [0, 2]), seen(1, [0]), seen(3, [3])])
    known = [
        (one.object_id, one.label, one.num_frames, one.last.frame) for one in records.objects()
    ]
    # What people declared to be one stays, whichever of the two is seen.
    assert known == [(0, "cup", 2, 1), (2, "cup", 1, 0), (4, "cup", 1, 3)]


def test_what_is_lost_goes_with_all_that_people_said_of_it():
    records = ObjectRecords()
    records.note(seen(0, [1, 2, 3, 4, 5]), None)
    records.rename(2, "Bob")
    records.merge(3, [4])
    records.keep({1})
    assert [one.object_id for one in records.objects()] == [1]
    records.rename(1, "Bob")
    assert records.merged_into == {}


def test_records_of_what_memory_lost_are_not_written(tracker):
    tracker.rename(2, "spoon")
    filed, _ = to_file(tracker.identities.records, {0, 1})
    assert [row.id for row in filed.objects] == [0, 1]
    assert filed.names == []


DAMAGES = (
    (lambda c: c["objects"].append(c["objects"][0] | {"pictures": []}), "has two records"),
    (lambda c: c["objects"][0].update(last=[9, 0]), "first seen after it was last seen"),
    (lambda c: c["objects"][0].update(first=[1, 99]), "first seen after it was last seen"),
    (lambda c: c["objects"][0].update(pictures=[]), "is no JPEG"),
    (lambda c: c["objects"][2]["pictures"].append([1.0, 9]), "no JPEG|pictures"),
    (lambda c: c.update(names=[[9, "mug"]]), "there is no object 9"),
    (lambda c: c.update(names=[[0, "a\nb"]]), "cannot be called"),
    (lambda c: c.update(merged=[[0, 0]]), "cannot be merged"),
    (lambda c: c.update(merged=[[0, 1], [1, 2], [2, 0]]), "was merged into"),
    (lambda c: c.update(session=0), "records"),
    (lambda c: c.pop("objects"), "records"),
    (lambda c: c["objects"][0].update(label="x" * 201), "records"),
)


def test_damaged_records_are_refused(tracker, tmp_path):
    path = tmp_path / "memory.safetensors"
    tracker.save(path)
    whole = path.read_bytes()
    for change, said in DAMAGES:
        path.write_bytes(whole)
        header = read_safetensors_header(path, refused=OutputError).metadata
        content = json.loads(header["records"])
        change(content)
        with pytest.raises(OutputError, match=said):
            load_memory(rewrite(path, header={"records": json.dumps(content)}))
    path.write_bytes(whole)
    with pytest.raises(OutputError, match="it lacks 'pictures'"):
        load_memory(rewrite(path, tensors={"pictures": None}))


def test_the_best_pictures_fit_first():
    views = [Picture(float(quality), bytes(10)) for quality in (1, 5, 3, 4)]
    assert [one.quality for one in best_of(views)] == [5.0, 4.0, 3.0]
    kept = fit_into(35, [best_of(views), best_of(views[:2]), ()])
    assert [[one.quality for one in own] for own in kept] == [[5.0, 4.0], [5.0], []]


def test_a_view_is_judged_less_and_less_often(monkeypatch):
    judged = []
    monkeypatch.setattr(
        "remind_jax.session.object_pictures.view_quality",
        lambda image, tracks, row: judged.append(tracks.frame_index) or 1.0,
    )
    image, pictures = np.zeros((48, 64, 3), np.uint8), Pictures()
    for number in range(40):
        pictures = pictures.look(image, seen(number, [0]), 0)
    assert judged == [0, 1, 3, 7, 15, 31]
    pictures = pictures.next_visit().look(image, seen(50, [0]), 0)
    assert judged[-1] == 50
    assert len(pictures.best) == 2


def test_what_is_one_stays_one_where_memory_lost_the_object_that_it_is_named_after():
    records = ObjectRecords()
    records.note(seen(0, [1, 2, 3]), None)
    records.merge(1, [2])
    records.rename(1, "mine")
    assert records.with_merged({2}) == {1, 2}
    assert records.with_merged({1, 3}) == {1, 2, 3}
    read = from_file([to_file(records, records.with_merged({2, 3}))])
    assert (read.merged_into, read.names) == (records.merged_into, records.names)


def test_a_split_takes_back_the_merges_into_an_object_and_no_others():
    records = ObjectRecords()
    records.note(seen(0, [0, 1, 6]), None)
    records.merge(0, [6])
    records.merge(1, [0])
    assert records.merged_into == {6: 1, 0: 1}
    read = from_file([to_file(records, {0, 1, 6})])
    for each in (records, read):
        assert each.split(1) == (0,)
        assert [(one.object_id, one.merged) for one in each.objects()] == [(0, (6,)), (1, ())]


def test_what_was_merged_step_by_step_is_split_step_by_step_in_a_joined_memory():
    other = ObjectRecords()
    other.note(seen(0, [0, 1, 6]), None)
    other.merge(0, [6])
    other.merge(1, [0])
    records, known = ObjectRecords(), ObjectRecords()
    records.take_in(other, {0: 10, 1: 11, 6: 16})
    assert records.split(11) == (10,)
    assert [(one.object_id, one.merged) for one in records.objects()] == [(10, (16,)), (11, ())]
    known.take_in(other, {1: 11, 6: 16})  # without what lies between
    assert known.merged_into == {16: 11}


def test_a_name_given_after_a_merge_leaves_the_others_theirs():
    records = ObjectRecords()
    for number in range(3):
        records.note(seen(number, [0, 1]), None)
    records.rename(0, "left")
    records.rename(1, "right")
    records.merge(0, [1])
    records.rename(0, "mug")
    assert records.split(0) == (1,)
    assert [one.name for one in records.objects()] == ["mug", "right"]


def test_of_merged_objects_that_are_given_one_name_the_last_keeps_it(tracker, tmp_path):
    tracker.rename(1, "mug")
    tracker.merge(0, 1)
    tracker.rename(0, "mug")
    tracker.save(tmp_path / "memory")
    tracker.load(tmp_path / "memory")
    assert tracker.split(0) == (1,)
    assert [one.name for one in tracker.objects()][:2] == ["mug", ""]


LABELS = ("bowl", "cup", "cup", "bowl", "cup", "cup")
SHOWN = ("bowl 0", "bowl 0", "cup 0", "cup 0", "cup 0", "cup 0")


def test_an_object_is_shown_by_the_class_of_most_of_its_detections(tmp_path):
    """Whatever a detector calls it in the frame."""
    tracker = Tracker({"input": {"class_agnostic": True}}, tracker="iou")
    image, labels = scenes.picture(0)
    found = [tracker.update(image, Detections.create((labels == 1)[None], [one])) for one in LABELS]
    assert [tracks.display_name(0) for tracks in found] == [*SHOWN]
    assert [tracks.labels[0] for tracks in found] == [*LABELS]
    assert tracker.objects()[0].title == "cup 0"
    tracker.save(tmp_path / "memory")
    other = Tracker({"input": {"class_agnostic": True}}, tracker="iou")
    other.load(tmp_path / "memory")
    tracks = other.update(image, Detections.create((labels == 1)[None], ["bowl"]))
    assert tracks.display_name(0) == "cup 0"


def test_a_run_shows_one_class_from_its_first_frame(tmp_path):
    image, labels = scenes.picture(0)
    source = [(image, Detections.create((labels == 1)[None], [one])) for one in LABELS]
    config = {"tracker": "iou", "input": {"class_agnostic": True}}
    result = rj.run(source, config=config, announce_after=1)
    result.save(tmp_path / "run")
    for shown in (result, rj.Result.load(tmp_path / "run")):
        assert {tracks.display_name(0) for tracks in shown.tracks} == {"cup 0"}
        assert shown.objects()[0].title == "cup 0"
