"""Identities from visit to visit, counted by hand."""

import dataclasses

import numpy as np
import pytest

from benchmarks.visit_scores import (
    count_visits,
    join_visits,
    score_visits,
    split_recovery,
    visit_scores,
)
from remind_jax.decision import Outcome
from remind_jax.errors import SourceError
from remind_jax.metrics.combine import pool_counts
from remind_jax.metrics.recovery import collect_answers, count_recovery, find_reference
from remind_jax.metrics.sequence import TrackingSequence
from remind_jax.tracks import Tracks
from tests.metrics.tables import from_frames
from tests.outputs import fake_run

NOBODY = -1


def visit(*frames: dict[int, int]) -> TrackingSequence:
    """Frames of objects, each with what it is called; NOBODY where it is not found."""
    truth = [sorted(frame) for frame in frames]
    called = [[frame[one] for one in sorted(frame) if frame[one] != NOBODY] for frame in frames]
    overlap = [
        np.array([[float(frame[one] == label) for label in labels] for one in ids]).reshape(
            len(ids), len(labels)
        )
        for frame, ids, labels in zip(frames, truth, called, strict=True)
    ]
    return from_frames(truth, called, overlap)


FIRST = visit({1: 10, 2: 20, 3: 30}, {1: 10, 2: 20, 3: 30}, {1: 10, 2: 20})


@pytest.mark.parametrize(
    ("second", "returning", "recognized", "at_once", "false"),
    [
        (visit({1: 10, 2: 20}), 2, 2, 2, 0),
        (visit({1: 40}, {1: 10}, {1: 10}), 1, 1, 0, 0),  # found after a frame
        (visit({1: 20}, {1: 20}), 1, 0, 0, 1),  # taken for another
        (visit({1: 40}, {1: 40}), 1, 0, 0, 0),  # taken for new
        (visit({1: NOBODY}, {1: NOBODY}), 1, 0, 0, 0),
        (visit({4: 40}), 0, 0, 0, 0),  # new, and called so
        (visit({4: 30}), 0, 0, 0, 1),  # new, taken for one that was known
        (visit({}), 0, 0, 0, 0),
    ],
)
def test_objects_of_the_second_visit(second, returning, recognized, at_once, false):
    (counts,) = count_visits([FIRST, second])
    assert counts.objects == len(set(second.gt.id.tolist()))
    assert (counts.returning, counts.recognized, counts.recognized_at_once) == (
        returning,
        recognized,
        at_once,
    )
    assert counts.falsely_recognized == false


def test_a_third_visit_knows_what_both_before_it_taught():
    second, third = visit({4: 40}, {4: 40}), visit({1: 10, 4: 40, 3: 99})
    counts = count_visits([FIRST, second, third])
    assert [float(one.returning) for one in counts] == [0, 3]
    assert [float(one.recognized) for one in counts] == [0, 2]
    scores = visit_scores(pool_counts(counts))
    assert scores["Recognized"] == pytest.approx(2 / 3)
    assert scores["FalseRecognitions"] == 0


def test_recovery_within_and_across_add_up():
    first = visit({1: 10}, {}, {1: 10}, {2: 20})
    second = visit({1: 10}, {}, {1: 50}, {2: 50})
    within, across = split_recovery([first, second])
    assert (within.opportunities, within.recovered) == (2, 1)
    assert (across.opportunities, across.recovered, across.hard_recovered) == (2, 1, 1)
    joined = collect_answers(join_visits([first, second], "both"))
    whole = count_recovery(joined, find_reference(joined))
    assert within.opportunities + across.opportunities == whole.opportunities.sum()


def test_classes_of_visits_are_joined_by_name():
    def of(label: str, other: str) -> TrackingSequence:
        return TrackingSequence.create(
            1,
            ([0, 0], [1, 2]),
            ([0, 0], [10, 20]),
            ([0, 1], [0, 1], [1.0, 1.0]),
            gt_class=[0, 1],
            pred_class=[0, 1],
            class_names=(label, other),
        )

    joined = join_visits([of("cup", "book"), of("book", "cup")], "both")
    assert joined.class_names == ("cup", "book")
    assert joined.gt.class_index.tolist() == [0, 1, 1, 0]
    assert joined.gt.frame.tolist() == [0, 0, 2, 2]


def test_one_visit_is_none():
    with pytest.raises(SourceError, match="give two or more"):
        join_visits([FIRST], "rooms")


def test_runs_are_scored_by_the_instances_they_were_given():
    tracks = [with_own_numbers(frame) for frame in fake_run.make_run()[1].tracks]
    scores = score_visits({"monday": tracks, "tuesday": tracks}).scores()
    assert scores["IDF1"] == scores["Recognized"] == scores["RecoveryAcrossVisits"] == 1
    assert scores["FalseRecognitions"] == 0


def with_own_numbers(frame: Tracks) -> Tracks:
    ids = np.arange(len(frame), dtype=np.int32)
    firm = np.full_like(frame.outcome, Outcome.MATCH)
    return dataclasses.replace(frame, object_id=ids, instance_ids=ids, outcome=firm)
