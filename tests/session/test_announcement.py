"""When objects get their ids: rules of the numbers, live, in runs, and over files.

The tracker by overlap serves here: what is announced does not depend on who decides.
"""

import csv
import dataclasses
import json
from typing import Any

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import remind_jax as rj
from remind_jax.decision import NO_ID, Outcome, Reason
from remind_jax.files.records import decode_json
from remind_jax.outputs.result import Result
from remind_jax.session import folder_run as session
from remind_jax.session.announcement import (
    DETECTOR_DEFAULT,
    Announcements,
    FiledAnnouncements,
    announce,
    as_announced,
    choose_after,
)
from remind_jax.session.memory_file import load_memory
from remind_jax.tracks import Tracks
from tests.cli import scenes
from tests.outputs.fake_run import make_tracks

STATIC = {"num_detections": 4, "num_objects": 16}
OPTIONS: dict[str, Any] = {"tracker": "iou", "config": {"static": STATIC}}
AFTER = 3
# The fourth thing is seen once in the middle, the third from the fifth frame on.
IN_VIEW = [(1, 2), (1, 2), (1, 2), (1, 2, 4), (1, 2, 3), (1, 2, 3), (1, 2, 3), (1, 2, 3)]
PICTURES = [scenes.picture(index, ids) for index, ids in enumerate(IN_VIEW)]


def frame_of(*rows: int | dict[str, Any], index: int = 0) -> Tracks:
    """A frame with these objects decided; a mapping says more of a detection."""
    given = [row if isinstance(row, dict) else {"object_id": row} for row in rows]
    return make_tracks(index, np.zeros((len(given), 2, 2), bool), given)


def follow(
    frames: list[Tracks], after: int, start: Announcements | None = None
) -> tuple[list[Tracks], Announcements]:
    """The answers about each frame at once, and what is announced in the end."""
    announced = Announcements.all_below(0) if start is None else start
    answers = []
    for tracks in frames:
        announced = announce(announced, tracks, after)
        answers.append(as_announced(announced, tracks))
    return answers, announced


def ids(answers: list[Tracks]) -> list[list[int]]:
    return [tracks.object_id.tolist() for tracks in answers]


def test_an_object_has_an_id_from_the_nth_detection_on():
    frames = [frame_of(7), frame_of(7, 4), frame_of(7)]
    answers, announced = follow(frames, 3)
    assert ids(answers) == [[NO_ID], [NO_ID, NO_ID], [0]]
    assert answers[0].outcome.tolist() == [Outcome.PROVISIONAL_NEW]
    assert answers[0].reason.tolist() == [Reason.SEEN_TOO_FEW_TIMES]
    assert answers[0].pending_id[0] == answers[1].pending_id[0] != answers[1].pending_id[1]
    assert answers[2].pending_id.tolist() == [-1]
    assert announced.counts == {4: 1}


def test_known_objects_are_announced_at_once():
    answers, announced = follow([frame_of(4, 6)], 5, Announcements.all_below(5))
    assert ids(answers) == [[4, NO_ID]]
    assert follow([frame_of(6)], 1, announced)[0][0].object_id.tolist() == [5]


def test_counts_of_what_memory_lost_are_not_written(tmp_path):
    tracker = rj.Tracker({"tracker": "iou", "static": STATIC}, announce_after=3)
    tracker.update(*scenes.picture(0, (1, 2)))
    before = tracker.identities.announcements
    tracker.identities.announcements = dataclasses.replace(before, counts={**before.counts, 77: 1})
    tracker.save(tmp_path / "memory.safetensors")
    assert load_memory(tmp_path / "memory.safetensors").announced == before


def test_candidates_speak_of_announced_objects_only():
    near = {"object_id": 9, "candidates": [(9, 0.9), (3, 0.5), (8, 0.4)]}
    doubt = {"outcome": Outcome.AMBIGUOUS, "object_id": NO_ID, "pending_id": 2}
    rows = [
        near,
        doubt | {"candidates": [(9, 0.6), (3, 0.3), (8, 0.1)]},
        doubt | {"candidates": [(9, 0.6), (8, 0.4)]},
        doubt | {"candidates": [(8, 0.6), (9, 0.4)]},
        doubt | {"outcome": Outcome.PROVISIONAL_PARENT, "candidates": [(8, 0.6)]},
    ]
    known = Announcements(0, {9: 0, 3: 1}, next_id=2)
    after = as_announced(known, frame_of(*rows))
    assert after.candidate_id[:, 0].tolist() == [0, 0, 0, 0, -1]
    assert after.candidate_id[:, 1].tolist() == [1, 1, -1, -1, -1]
    np.testing.assert_array_equal(after.candidate_score[:, 0], np.float32([0.9, 0.6, 0.6, 0.4, 0]))
    assert after.outcome.tolist() == [
        Outcome.MATCH,
        Outcome.AMBIGUOUS,
        Outcome.PROVISIONAL_PARENT,  # the only one left
        Outcome.PROVISIONAL_NEW,  # most likely one that is not announced
        Outcome.PROVISIONAL_NEW,
    ]
    assert after.reason[2:].tolist() == [
        Reason.UNCERTAIN_PARENT, Reason.UNCERTAIN_NEW, Reason.UNCERTAIN_NEW
    ]  # fmt: skip
    assert after.pending_id.tolist() == [-1, 2, 2, 2, 2]
    waiting = as_announced(Announcements.all_below(0), frame_of(near))
    assert waiting.candidate_id.tolist() == [[-1, -1, -1]]


def test_detections_of_objects_that_turn_out_to_be_one_add_up():
    frames = [frame_of(1), frame_of(2), frame_of(1)]
    announced = Announcements.all_below(0)
    for tracks, merges in zip(frames, ([], [], [(2, 1)]), strict=True):
        announced = announce(announced, tracks, 3, merges)
    assert ids([as_announced(announced, tracks) for tracks in frames]) == [[0], [0], [0]]


def test_an_announced_id_stays_when_its_object_turns_out_to_be_one_never_announced():
    new = {"outcome": Outcome.NEW}
    frames = [frame_of(new | {"object_id": 1}), frame_of(new | {"object_id": 2}), frame_of(2)]
    _, announced = follow(frames, 2)
    last = frame_of(1)
    announced = announce(announced, last, 2, [(2, 1)])
    final = [as_announced(announced, tracks) for tracks in [*frames, last]]
    assert ids(final) == [[0], [0], [0], [0]]
    assert [tracks.outcome[0] for tracks in final] == [Outcome.NEW] + 3 * [Outcome.MATCH]
    assert follow([frame_of(5)], 1, announced)[0][0].object_id.tolist() == [1]


def test_no_id_is_given_to_two_objects_of_a_frame():
    both = frame_of(1, 2)
    announced = Announcements.all_below(0)
    for tracks, merges in ((both, []), (frame_of(2), []), (frame_of(1), [(2, 1)])):
        announced = announce(announced, tracks, 2, merges)
    answers = as_announced(announced, both)
    assert answers.object_id.tolist() == [NO_ID, 0]  # the one that was announced
    assert answers.outcome[0] == Outcome.PROVISIONAL_NEW


# An object that is twice in a frame was detected once.
RUNS = st.lists(st.lists(st.integers(0, 12), max_size=6), min_size=1, max_size=12)
AFTERS = st.integers(1, 5)


@given(RUNS, AFTERS)
def test_ids_are_dense_and_stay(run, after):
    frames = [frame_of(*rows, index=index) for index, rows in enumerate(run)]
    online, announced = follow(frames, after)
    final = [as_announced(announced, tracks) for tracks in frames]
    times = {i: sum(i in rows for rows in run) for rows in run for i in rows}
    given_ids = {i for tracks in final for i in tracks.object_id.tolist() if i != NO_ID}
    assert given_ids == set(range(sum(count >= after for count in times.values())))
    for now, later in zip(online, final, strict=True):
        assert ((now.object_id == NO_ID) | (now.object_id == later.object_id)).all()


@given(RUNS, AFTERS, st.randoms(use_true_random=False))
def test_the_order_of_detections_does_not_matter(run, after, random):
    orders = [random.sample(range(len(rows)), len(rows)) for rows in run]
    frames = [frame_of(*rows) for rows in run]
    shuffled = [
        frame_of(*(rows[place] for place in order)) for rows, order in zip(run, orders, strict=True)
    ]
    for tracks, other, order in zip(
        follow(frames, after)[0], follow(shuffled, after)[0], orders, strict=True
    ):
        assert other.object_id.tolist() == tracks.object_id[order].tolist()


@given(RUNS, AFTERS, st.integers(0, 12))
def test_a_run_in_two_parts_is_the_whole_run(run, after, cut):
    frames = [frame_of(*rows, index=index) for index, rows in enumerate(run)]
    whole, _ = follow(frames, after)
    first, announced = follow(frames[:cut], after)
    saved = msgspec.json.encode(announced.filed())
    restored = decode_json(saved, FiledAnnouncements, "here").restored()
    second, _ = follow(frames[cut:], after, restored)
    assert ids(first + second) == ids(whole)


def test_objects_of_another_memory_are_announced_under_the_next_numbers():
    own = Announcements(0, {2: 0, 5: 1}, {6: 2}, {}, 2)
    ids = {4: 14, 7: 17, 8: 18}
    other = Announcements(0, {4: 3, 7: 1, 9: 2}, {8: 3, 1: 4}, {}, 4)
    now, number_of = own.joined(other, ids)
    assert number_of == {1: 2, 3: 3}
    assert [now.id_of(one) for one in (2, 5, 6, 17, 14, 18)] == [0, 1, NO_ID, 2, 3, NO_ID]
    assert (now.counts, now.next_id) == ({6: 2, 18: 3}, 4)
    assert Announcements().joined(other, ids) == (Announcements(), {1: 17, 3: 14})
    now, number_of = own.joined(Announcements(), ids)
    assert number_of == {4: 2, 7: 3, 8: 4}
    assert now.id_of(17) == 3


def test_numbers_of_explanations_are_one_to_one():
    announced = Announcements(0, {5: 0, 2: 1}, {7: 1}, next_id=2)
    assert announced.number([7, 5, 2, 9, NO_ID]) == {5: 0, 2: 1, 7: 2, 9: 3, NO_ID: NO_ID}


@pytest.mark.parametrize(
    ("asked", "configured", "has_detector", "after"),
    [
        (None, 0, False, 1),
        (None, 0, True, DETECTOR_DEFAULT),
        (0, 0, True, DETECTOR_DEFAULT),
        (None, 7, True, 7),
        (None, 7, False, 7),
        (2, 7, True, 2),
        (1, 0, True, 1),
    ],
)
def test_who_chooses(asked, configured, has_detector, after):
    assert choose_after(asked, configured, has_detector) == after


def detect(image: np.ndarray) -> dict[str, Any]:
    known = {picture.tobytes(): scenes.masks_of(labels) for picture, labels in PICTURES}
    return {"masks": known[image.tobytes()]}


def run(**options: Any) -> Result:
    images = [image for image, _ in PICTURES]
    return rj.run(images, detector=detect, overlay=False, **OPTIONS | options)


EXPECTED = [[0, 1]] * 3 + [[0, 1, NO_ID]] + [[0, 1, 2]] * 4


def test_masks_are_announced_at_once_and_detections_of_a_detector_are_not():
    given = rj.run(PICTURES, **OPTIONS)
    assert ids(list(given.tracks))[3] == [0, 1, 2]
    assert given.info.config["input"]["announce_after"] == 1
    result = run()
    assert result.info.config["input"]["announce_after"] == DETECTOR_DEFAULT


def test_a_run_carries_ids_back(tmp_path):
    result = run(announce_after=AFTER, out=tmp_path)
    assert ids(list(result.tracks)) == EXPECTED
    first_sights = [(0, 0), (0, 1), (4, 2)]
    for frame, row in first_sights:
        assert result.tracks[frame].outcome[row] == Outcome.NEW
    assert [thing.first_frame for thing in result.objects()] == [0, 0, 4]
    assert result.summary()["identities"] == 3
    assert [event.message for event in result.events] == [
        "1 object without an id: detected fewer than 3 times (--announce-after)"
    ]
    assert ids(list(Result.load(tmp_path).tracks)) == EXPECTED
    with (tmp_path / "tracks.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert [int(row["object_id"]) for row in rows] == [i for frame in EXPECTED for i in frame]
    assert rows[8]["outcome"] == "provisional_new"
    assert rows[8]["reason"] == "seen_too_few_times"
    assert (tmp_path / "mot.txt").read_text().count("\n") == len(rows) - 1
    assert not list(tmp_path.glob("*.part"))
    answers = json.loads((tmp_path / "run.json").read_text())
    assert answers["info"]["config"]["input"]["announce_after"] == AFTER


def test_late_announcements_reach_what_was_written_before(tmp_path):
    """An object that comes back is announced long after its first sight."""
    views = [(1, 2), (1,), (1,), (1,), (1,), (1, 2)]
    pictures = [scenes.picture(12, view) for view in views]  # nothing moves
    known = {index: scenes.masks_of(labels) for index, (_, labels) in enumerate(pictures)}
    frames = [
        rj.Frame(i, i, float(i), str(i), image, rj.Detections.create(known[i]))
        for i, (image, _) in enumerate(pictures)
    ]
    options = OPTIONS | {"tracker": "running-mean"}  # that by overlap soon forgets
    result = rj.run(frames, announce_after=2, out=tmp_path, overlay=False, **options)
    final = [[0, 1], *[[0]] * 4, [0, 1]]
    assert ids(list(result.tracks)) == final
    assert ids(list(Result.load(tmp_path).tracks)) == final


def test_pictures_wait_for_announcements(tmp_path, monkeypatch):
    """Overlay and gallery are drawn once, so frames come to them some frames late."""
    drawn: list[Tracks] = []
    monkeypatch.setattr(session.RunWriter, "add", lambda self, frame, tracks: drawn.append(tracks))
    run(announce_after=AFTER, out=tmp_path)
    assert ids(drawn) == EXPECTED
    drawn.clear()
    run(announce_after=1, out=tmp_path, overwrite=True)
    assert ids(drawn)[3] == [0, 1, 2]


def test_live_ids_stay_from_run_to_run(tmp_path):
    tracker = rj.Tracker(announce_after=AFTER, **OPTIONS)
    first = [tracker.update(*picture) for picture in PICTURES[:4]]
    assert ids(first) == [[NO_ID, NO_ID], [NO_ID, NO_ID], [0, 1], [0, 1, NO_ID]]
    tracker.save(tmp_path / "memory.safetensors")
    for after, expected in ((AFTER, [NO_ID, NO_ID, 2, 2]), (1, [2, 2, 2, 2])):
        tracker = rj.Tracker(announce_after=after, **OPTIONS)
        tracker.load(tmp_path / "memory.safetensors")
        assert ids([tracker.update(*picture) for picture in PICTURES[4:]]) == [
            [0, 1, last] for last in expected
        ]
