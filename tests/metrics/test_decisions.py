from __future__ import annotations

import numpy as np

from remind_jax.decision import NO_ID, Outcome
from remind_jax.metrics.decisions import NO_ROW, Decisions
from tests.metrics.test_run_evaluation import make_run


def test_a_run_is_one_table_of_its_detections():
    run = make_run()
    decisions = Decisions.of_tracks(run)
    assert len(decisions.outcome) == sum(map(len, run))
    firm = np.concatenate([frame.is_firm for frame in run])
    assert decisions.is_firm.tolist() == firm.tolist()
    assert (decisions.object_id[~firm] == NO_ID).all()
    assert Decisions.of_tracks([]).candidate_id.shape == (0, 0)


def test_where_there_is_no_detection_nothing_is_decided():
    taken = Decisions.of_ids(np.array([7, 8])).take(np.array([1, NO_ROW]))
    assert taken.outcome.tolist() == [Outcome.MATCH, Outcome.EMPTY]
    assert taken.object_id.tolist() == [8, NO_ID]
    assert taken.is_firm.tolist() == [True, False]
