import dataclasses
import time

import numpy as np
import pytest

from remind_jax.decision import Outcome
from remind_jax.errors import OutputError
from remind_jax.outputs import tables
from remind_jax.sources import detections_from
from tests.outputs.fake_run import make_tracks


def rated(**row):
    return make_tracks(0, np.ones((1, 8, 8), bool), [row])


@pytest.mark.parametrize("outcome", [Outcome.EMPTY, Outcome.UNASSIGNED, Outcome.DROPPED])
def test_what_was_left_out_has_no_numbers(outcome):
    tracks = rated(outcome=outcome)
    assert tracks.shown_score(0) is tracks.shown_confidence(0) is None
    assert (tracks.display_name(0) == tracks.labels[0]) == (outcome == Outcome.DROPPED)


def test_new_objects_have_numbers_where_the_tracker_rates_them():
    unrated = rated(outcome=Outcome.NEW, object_id=0, score=0.0, confidence=0.02)
    assert unrated.shown_score(0) is unrated.shown_confidence(0) is None
    plus = rated(outcome=Outcome.NEW, object_id=0, score=0.85, confidence=0.85)
    assert plus.shown_confidence(0) == pytest.approx(0.85)


def test_a_score_that_is_the_confidence_is_shown_once():
    assert rated(object_id=0, score=0.55, confidence=0.55).shown_score(0) is None
    both = rated(object_id=0, score=1.018, confidence=0.4)
    assert both.shown_score(0) == pytest.approx(1.018)
    assert both.shown_confidence(0) == pytest.approx(0.4)


def test_rows_of_the_table_leave_cells_empty():
    rows = [{"object_id": 0, "outcome": Outcome.NEW, "score": 0.0}, {"object_id": 1}]
    tracks = make_tracks(0, np.ones((2, 8, 8), bool), rows)
    new, match = tables.detection_rows(tracks)
    assert (new["score"], new["confidence"]) == (None, None)
    assert (match["score"], match["confidence"]) == (0.9, 0.8)
    same = dataclasses.replace(tracks, confidence=tracks.score)
    assert [row["score"] for row in tables.detection_rows(same)] == [None, None]


def cups_and_tv():
    masks = np.zeros((3, 20, 30), bool)
    masks[0, 2:8, 3:9] = masks[1, 10:18, 4:12] = masks[2, 2:18, 14:28] = True
    rows = [
        {"object_id": 3, "label": "cup"},
        {"object_id": -1, "outcome": Outcome.AMBIGUOUS, "candidates": [(3, 0.8), (5, 0.7)]},
        {"object_id": 5, "label": "tv"},
    ]
    tracks = make_tracks(0, masks, rows)
    return dataclasses.replace(tracks, labels=("cup", "cup", "tv"), names={5: "my tv"})


def test_what_it_could_be_is_called_as_it_is_elsewhere():
    tracks = cups_and_tv()
    alone = np.where(tracks.candidate_id == 3, -1, tracks.candidate_id)
    assert dataclasses.replace(tracks, candidate_id=alone).display_name(1) == "my tv?"
    assert dataclasses.replace(tracks, names={}).display_name(1) == "cup 3 or 5?"


def test_supervision_gets_a_frame_that_can_be_tracked_again():
    pytest.importorskip("supervision")
    tracks = cups_and_tv()
    found = tracks.to_supervision(["bowl", "tv", "cup"])
    assert found.class_id is not None
    assert found.class_id.tolist() == [2, 2, 1]
    assert found.tracker_id is not None
    assert found.tracker_id.tolist() == [3, -1, 5]
    assert list(found.data["class_name"]) == ["cup", "cup", "tv"]
    assert list(found.data["display_name"]) == ["cup 3", "cup 3 or my tv?", "my tv"]
    np.testing.assert_array_equal(found.xyxy, [[3, 2, 9, 8], [4, 10, 12, 18], [14, 2, 28, 18]])
    np.testing.assert_array_equal(found.mask, tracks.masks)
    plain = tracks.to_supervision()
    assert plain.class_id is not None
    assert plain.class_id.tolist() == [0, 0, 1]  # counted as they come
    again = detections_from(plain, tracks.frame_size)
    assert again.labels == tracks.labels
    np.testing.assert_array_equal(np.asarray(again.masks), tracks.masks)
    np.testing.assert_array_equal(again.scores, tracks.detector_scores)
    for names, said in (
        (["cup"], "class 'tv' is not among the 1 class names"),
        ("cup", "one text, 'cup'"),
    ):
        with pytest.raises(OutputError, match=said):
            tracks.to_supervision(names)


def test_what_is_shown_of_a_crowd_takes_no_time():
    """Comparing numbers of NumPy with an enumeration took 60 us a detection."""
    tracks = rated(object_id=0, score=0.55, confidence=0.5)
    begun = time.process_time()
    for _ in range(20_000):
        tracks.shown_confidence(0)
    assert time.process_time() - begun < 0.4
