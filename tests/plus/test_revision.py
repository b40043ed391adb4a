"""Answers that wait for some frames, revised by what is known then."""

import dataclasses
import types

import numpy as np
import pytest

from remind_jax.decision import Outcome, Status
from remind_jax.numerics.absent import NO_ID
from remind_jax.plus.revision import DelayedAnswers, evidence, find_merges
from remind_jax.tracks import Tracks
from tests.outputs.fake_run import make_tracks


def answers(index: int, ids, outcomes) -> Tracks:
    blank = {"score": 0.5, "confidence": 0.5, "candidates": [(9, 0.0)]}
    rows = [
        {**blank, "object_id": one, "outcome": outcome, "pending_id": 5 if one == NO_ID else NO_ID}
        for one, outcome in zip(ids, outcomes, strict=True)
    ]
    return make_tracks(index, np.ones((len(ids), 4, 4), bool), rows)


def state(tracklets, answer=None, is_open=True):
    num = len(tracklets)
    answers = types.SimpleNamespace(
        tracklet_id=np.array(tracklets),
        answer_id=np.full(num, NO_ID) if answer is None else np.array(answer),
    )
    those = types.SimpleNamespace(
        id=np.array(tracklets), alive=np.ones(num, bool), slot=np.full(num, -1 if is_open else 0)
    )
    return types.SimpleNamespace(answers=answers, tracklets=those)


def run(delay, frames):
    """Object ids of all frames as they leave."""
    held = DelayedAnswers(delay)
    out = [pair for tracks, after in frames for pair in held.push(None, tracks, evidence(after))]
    return [tracks for _, tracks in out + held.flush()]


@pytest.mark.parametrize("delay", [0, 1, 3])
def test_every_frame_leaves_once_and_in_order(delay):
    frames = [(answers(i, [2], [Outcome.MATCH]), state([7])) for i in range(5)]
    assert [tracks.frame_index for tracks in run(delay, frames)] == [0, 1, 2, 3, 4]


def test_only_what_waits_is_kept():
    held = DelayedAnswers(3)
    for index in range(20):
        given = answers(index, [index], [Outcome.NEW]), evidence(state([index]))
        held.push(None, *given)
    assert sorted(held._latest) == [17, 18, 19]


def test_an_open_tracklet_gets_the_answer_that_it_has_later():
    ambiguous = answers(0, [NO_ID], [Outcome.AMBIGUOUS])
    ambiguous = dataclasses.replace(ambiguous, status=np.array([Status.AMBIGUOUS]))
    frames = [(ambiguous, state([7])), (answers(1, [3], [Outcome.MATCH]), state([7]))]
    first, _ = run(1, frames)
    assert first.object_id.tolist() == [3]
    assert first.status.tolist() == [Status.STRONG]
    assert first.outcome.tolist() == [Outcome.MATCH]
    assert first.pending_id.tolist() == [NO_ID]
    assert first.candidate_id.max() == NO_ID
    at_once, _ = run(0, frames)  # the frames that were given are as they were
    assert at_once.object_id.tolist() == [NO_ID]


def test_a_new_object_that_turned_out_to_be_known_is_that_one_from_the_start():
    frames = [
        (answers(0, [7], [Outcome.NEW]), state([7])),
        (answers(1, [3], [Outcome.MATCH]), state([7])),
    ]
    assert [tracks.object_id.tolist() for tracks in run(1, frames)] == [[3], [3]]


def test_what_was_to_be_new_turns_out_to_be_known_once_it_is_decided():
    assert find_merges(state([7, 4], answer=[7, 4], is_open=False)) == []
    as_known = {"tracklets": [7, 4], "answer": [3, 4]}
    assert find_merges(state(**as_known)) == []
    assert find_merges(state(**as_known, is_open=False)) == [(7, 3)]


def test_an_answer_that_stays_is_as_sure_as_it_is_by_then():
    first = answers(0, [3], [Outcome.MATCH])
    later = dataclasses.replace(answers(1, [3], [Outcome.MATCH]), confidence=np.array([0.75]))
    told, _ = run(1, [(first, state([7])), (later, state([7]))])
    assert (told.confidence.tolist(), told.score.tolist()) == ([0.75], [0.75])
    assert first.confidence.tolist() == [0.5]


def test_no_id_is_given_twice_in_a_frame():
    both = [Outcome.MATCH, Outcome.AMBIGUOUS]
    frames = [
        (answers(0, [3, NO_ID], both), state([7, 8])),
        (answers(1, [NO_ID, 3], both[::-1]), state([7, 8])),
    ]
    first, _ = run(1, frames)
    assert first.object_id.tolist() == [3, NO_ID]


def test_two_that_trade_ids_both_get_their_own():
    matched = [Outcome.MATCH, Outcome.MATCH]
    frames = [
        (answers(0, [3, 4], matched), state([7, 8])),
        (answers(1, [4, 5], matched), state([7, 8])),
    ]
    first, _ = run(1, frames)
    assert first.object_id.tolist() == [4, 5]


@pytest.mark.parametrize("delay", [0, 1, 3])
def test_an_object_is_new_in_the_first_frame_that_it_is_answered_in(delay):
    named = [(NO_ID, Outcome.AMBIGUOUS), (7, Outcome.NEW), (7, Outcome.MATCH), (7, Outcome.MATCH)]
    frames = [(answers(i, [one], [said]), state([7])) for i, (one, said) in enumerate(named)]
    told = run(delay, frames)
    firm = [tracks.outcome[0] for tracks in told if tracks.object_id[0] != NO_ID]
    assert firm == [Outcome.NEW] + [Outcome.MATCH] * (len(firm) - 1)
    assert len(firm) == (3 if delay == 0 else 4)
