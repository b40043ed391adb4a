import dataclasses

import numpy as np
import pytest

from remind_jax.decision import Outcome
from remind_jax.outputs import tables
from tests.outputs.fake_run import make_tracks


def rated(**row):
    return make_tracks(0, np.ones((1, 8, 8), bool), [row])


@pytest.mark.parametrize("outcome", [Outcome.EMPTY, Outcome.UNASSIGNED, Outcome.DROPPED])
def test_what_was_left_out_has_no_numbers(outcome):
    tracks = rated(outcome=outcome)
    assert tracks.shown_score(0) is tracks.shown_confidence(0) is None


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
