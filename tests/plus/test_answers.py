"""What is reported of each detection: firm answers, doubts, and how probable they are."""

from typing import Any

import jax
import numpy as np
import pytest

from remind_jax.decision import NO_ID, Outcome, Reason
from remind_jax.numerics.absent import NO_SLOT
from remind_jax.plus.answers import report
from remind_jax.plus.verdicts import Stage, no_verdicts
from tests.plus.frames import STATIC, T, detections, tracklets_of

KNOWN, OTHER, OWN = 2, 3, 7
_report = jax.jit(report, static_argnames="static")


def report_one(
    belief,
    *,
    answer=KNOWN,
    decided=False,
    named=False,
    valid=True,
    moves=0.0,
    stays=1.0,
    size=1.0,
    trust=1.0,
    stage=Stage.NONE,
    num_moves=0.0,
):
    """One detection whose candidates are `KNOWN` and `OTHER`; the other slots are empty."""

    verdicts: Any = no_verdicts(STATIC.num_detections)
    verdicts.option_belief[0, : len(belief)] = belief
    if valid:
        verdicts.tracklet_id[0], verdicts.answer_id[0] = OWN, answer
    verdicts.option_id[0, :2], verdicts.is_decided[0] = (KNOWN, OTHER), decided
    verdicts.stage[0] = stage
    verdicts.probability[0] = {KNOWN: belief[0], OTHER: belief[1], OWN: 1 - sum(belief)}[answer]
    seen = detections([[1, 1], [2, 2], [3, 3]], size=np.full(3, size, np.float32))
    here = tracklets_of(
        seen,
        0,
        3,
        named=np.array([named, False, False]),
        slot=np.full(3, NO_SLOT, np.int32),
        trust=np.full(3, trust, np.float32),
        num_moves=np.full(3, num_moves, np.float32),
    )
    present = np.array([True, False, False])
    moving, staying = (np.full(3, share, np.float32) for share in (moves, stays))
    return _report(verdicts, moving, staying, here, present, seen, STATIC, T.decision)


def test_a_probable_answer_is_firm_before_it_is_decided():
    told = report_one([0.9, 0.05])
    assert told.outcome.tolist() == [Outcome.MATCH, Outcome.EMPTY, Outcome.EMPTY]
    assert told.object_id.tolist() == [KNOWN, NO_ID, NO_ID]
    assert told.pending_id[0] == NO_ID
    assert (told.option_id == NO_ID).all()


def test_doubt_names_the_known_objects_that_it_could_be():
    told = report_one([0.25, 0.2])
    assert told.outcome[0] == Outcome.AMBIGUOUS
    assert told.object_id[0] == NO_ID
    assert told.pending_id[0] == OWN
    assert told.option_id[0].tolist() == [KNOWN, OTHER, NO_ID]
    np.testing.assert_allclose(told.option_score[0], [0.25, 0.2, 0.0], rtol=1e-5)
    assert report_one([0.25, 0.05]).outcome[0] == Outcome.PROVISIONAL_PARENT


def test_what_is_rather_new_has_no_id_that_nothing_has():
    told = report_one([0.3, 0.2], answer=OWN, size=0.2)
    assert (told.outcome[0], told.reason[0]) == (Outcome.PROVISIONAL_NEW, Reason.UNCERTAIN_NEW)
    assert told.option_id[0].tolist() == [KNOWN, OTHER, NO_ID]
    hardly = report_one([0.05, 0.04])
    assert hardly.outcome[0] == Outcome.PROVISIONAL_NEW
    assert (hardly.option_id == NO_ID).all()
    assert (hardly.candidate_id == NO_ID).all()


def test_what_it_can_hardly_be_is_not_named():
    """The answer neither, where another detection has the object that it looks like."""
    told = report_one([0.97, 0.02], answer=OWN)
    assert told.outcome[0] == Outcome.PROVISIONAL_PARENT
    assert told.reason[0] == Reason.UNCERTAIN_PARENT
    assert told.option_id[0].tolist() == [KNOWN, NO_ID, NO_ID]
    assert told.option_score[0, 1:].tolist() == [0.0, 0.0]


def test_what_passed_to_another_thing_more_likely_than_not_has_no_firm_answer_any_more():
    assert report_one([0.6, 0.1], decided=True, trust=0.6).object_id[0] == KNOWN
    told = report_one([0.3, 0.1], decided=True, trust=0.4)
    assert (told.outcome[0], told.object_id[0]) == (Outcome.AMBIGUOUS, NO_ID)
    assert told.pending_id[0] == OWN
    assert told.option_id[0].tolist() == [KNOWN, NO_ID, NO_ID]
    np.testing.assert_allclose(told.option_score[0], [0.3, 0.0, 0.0])
    assert report_one([0.9, 0.05], trust=0.4).object_id[0] == KNOWN, "it is still asked"


@pytest.mark.parametrize("named", [False, True])
def test_a_new_object_is_new_once(named):
    told = report_one([0.01, 0.01], answer=OWN, decided=True, named=named)
    assert told.outcome[0] == (Outcome.MATCH if named else Outcome.NEW)
    assert told.object_id[0] == OWN


def test_confidence_rises_with_belief_and_is_higher_once_decided():
    low, high = (report_one([belief, 0.0]).confidence[0] for belief in (0.6, 0.9))
    decided = report_one([0.6, 0.0], decided=True).confidence[0]
    assert 0 < low < high < 1
    assert low < decided
    assert report_one([0.6, 0.0]).confidence[1] == 0  # an empty slot


def test_the_new_id_of_a_small_object_waits_until_it_is_more_certain():
    small = report_one([0.3, 0.0], answer=OWN, size=0.2)
    assert 0.5 < small.confidence[0] < T.decision.firm_small
    assert small.object_id[0] == NO_ID
    assert small.outcome[0] == Outcome.PROVISIONAL_NEW
    assert report_one([0.3, 0.0], answer=OWN, size=1.0).object_id[0] == OWN
    assert report_one([0.001, 0.0], answer=OWN, size=0.2).object_id[0] == OWN
    assert report_one([0.7, 0.0], size=0.2).object_id[0] == KNOWN, "a known object need not"


def test_what_is_decided_as_new_and_was_never_whole_is_believed_less():
    now = {"decided": True, "stage": Stage.OPEN}
    for known, least, most in ((0.01, 0.7, 0.9), (0.3, 0.5, 0.6)):
        cut, whole = (
            report_one([known, 0.0], answer=OWN, num_moves=num, **now) for num in (0.0, 3.0)
        )
        assert cut.object_id[0] == whole.object_id[0] == OWN
        assert least < cut.confidence[0] < most < whole.confidence[0]
    known = [report_one([0.99, 0.0], num_moves=num, **now).confidence[0] for num in (0.0, 3.0)]
    assert known[0] == known[1], "what it is like is seen"


@pytest.mark.parametrize(
    ("calm", "restless"),
    [({"moves": 0.0}, {"moves": 0.8}), ({"stays": 1.0}, {"stays": 0.3})],
    ids=["what moves", "one whose class moves"],
)
def test_less_is_claimed_once_it_is_decided_of(calm, restless):
    (still, moving), open_ones = (
        [
            report_one([0.99, 0.0], decided=decided, **kind).confidence[0]
            for kind in (calm, restless)
        ]
        for decided in (True, False)
    )
    assert 0.5 < moving < still - 0.02
    assert open_ones[0] == open_ones[1], "what is open may still be corrected"


def test_a_mask_without_usable_features_is_dropped():
    told = report_one([0.9, 0.05], valid=False)
    assert told.outcome.tolist() == [Outcome.DROPPED, Outcome.EMPTY, Outcome.EMPTY]
    assert told.confidence[0] == 0
