"""A new detection that looks like an object already matched (method.md#competition)."""

from __future__ import annotations

import dataclasses
from typing import Any

import pytest

from remind_jax.decision import Outcome, Reason
from remind_jax.remind.memory.objects import Lifecycle
from remind_jax.remind.thresholds import Thresholds
from tests.remind.association.tables import Frame, decide_frames, visual_frame

COMPETITION = Reason.KNOWN_AND_COMMITTED_NEW_COMPETITION


def compete(frame: Frame, **changed: Any) -> list[list[int]]:
    """Options of the detections that compete, by detection."""
    t = Thresholds()
    t = dataclasses.replace(t, competition=dataclasses.replace(t.competition, **changed))
    d = decide_frames([frame], [t]).decisions
    assert ((d.reason[0] == COMPETITION) <= (d.outcome[0] == Outcome.AMBIGUOUS)).all()
    return [
        [int(o) for o in options if o >= 0] if reason == COMPETITION else []
        for options, reason in zip(d.option_id[0], d.reason[0], strict=True)
    ]


PAIR = [{0: 0.93}, {0: 0.90}]  # the first one is locked, so the second one is "blocked"


@pytest.mark.parametrize(
    ("lifecycle", "age", "changed", "competes"),
    [
        (Lifecycle.CONFIRMED, 50, {}, True),
        (Lifecycle.CONFIRMED, 50, {"confirmed_parents": False}, False),
        (Lifecycle.CONFIRMED, 50, {"enabled": False}, False),
        (Lifecycle.INACTIVE, 0, {}, False),
        (Lifecycle.TENTATIVE, 2, {}, True),
        (Lifecycle.TENTATIVE, 3, {}, False),
        (Lifecycle.TENTATIVE, 3, {"young_only": False}, True),
        (Lifecycle.TENTATIVE, 3, {"max_parent_age": 3}, True),
        (Lifecycle.NEW, 1, {}, True),
    ],
)
def test_which_parents_compete(x64, lifecycle, age, changed, competes):
    frame = visual_frame(PAIR, lifecycle=lifecycle, age=age)
    expected = [[0, 1], [0, 1]] if competes else [[], []]
    assert compete(frame, **changed)[:2] == expected


@pytest.mark.parametrize(
    ("scores", "competes"),
    [
        ((0.89, 0.87), True),
        ((0.89, 0.85), False),  # confirmed parents: at most 0.03 apart
        ((0.86, 0.84), False),  # and at least 0.85 each
        ((0.95, 0.91), True),  # behind a lock: 0.05 apart
        ((0.95, 0.89), False),
    ],
)
def test_scores_of_confirmed_parents(x64, scores, competes):
    frame = visual_frame([{0: value} for value in scores])
    assert bool(compete(frame)[1]) == competes
