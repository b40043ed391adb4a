"""Assignments among look-alikes that are too close to call.

Rules: method.md#identity-stability, method.md#stability-entries.
"""

from __future__ import annotations

import dataclasses
import itertools
from typing import Any

import numpy as np
import pytest

from remind_jax.decision import Outcome, Reason
from remind_jax.remind.thresholds import Thresholds
from tests.remind.association.tables import Verdict, backed, decide_frames, visual_frame

STABILITY = Reason.KNOWN_BUT_AMBIGUOUS_IDENTITY_STABILITY
# Without the other guards a detection is matched, new, or doubtful.
ALONE = {
    name: dataclasses.replace(getattr(Thresholds(), name), enabled=False)
    for name in ("ambiguous", "competition", "provisional", "known_sets")
}


def decide(rows: list[list[float]], **changed: Any) -> Verdict:
    thresholds = dataclasses.replace(Thresholds(), **ALONE)
    stability = dataclasses.replace(thresholds.stability, **changed)
    thresholds = dataclasses.replace(thresholds, stability=stability)
    return decide_frames([visual_frame([dict(enumerate(row)) for row in rows])], [thresholds])


def doubtful(verdict: Verdict) -> list[int]:
    d = verdict.decisions
    assert (d.reason[0][d.outcome[0] == Outcome.AMBIGUOUS] == STABILITY).all()
    return np.flatnonzero(d.outcome[0] == Outcome.AMBIGUOUS).tolist()


@pytest.mark.parametrize("gap", [0.0, 0.02, 0.05, 0.2])
def test_doubt_is_the_gap_of_the_two_best_assignments(x64, gap):
    """Against all assignments of three look-alikes, one by one."""
    rng = np.random.default_rng(int(100 * gap))
    num_doubtful = 0
    for _ in range(12):
        table = rng.uniform(0.76, 0.89, (3, 3))  # all open, no locks
        ways = sorted(
            itertools.permutations(range(3)),
            key=lambda way: -sum(table[n, o] for n, o in enumerate(way)),
        )
        first, second = (np.array(way) for way in ways[:2])
        lead = sum(table[n, first[n]] - table[n, second[n]] for n in range(3))
        verdict = decide(table.tolist(), assignment_gap=gap)
        expected = np.flatnonzero(first != second).tolist() if lead <= gap else []
        assert doubtful(verdict) == expected
        num_doubtful += len(expected)
        for n in set(range(3)) - set(expected):
            assert verdict.decisions.object_id[0, n] == first[n]
        for n in expected:
            named = {int(o) for o in verdict.decisions.option_id[0, n] if o >= 0}
            assert named >= {int(first[n]), int(second[n])}
    assert (num_doubtful > 0) == (gap > 0)


def test_five_look_alikes_are_too_many_to_enumerate(x64):
    """Components of more than four are left as they are unless they lean on rescued pairs."""
    table = np.full((5, 5), 0.80) + 0.001 * np.eye(5)
    assert doubtful(decide(table.tolist())) == []
    assert doubtful(decide(table[:4, :4].tolist())) != []


@pytest.mark.parametrize(("margin", "kept"), [(0.05, [1, -1]), (0.10, [0, 1])])
def test_a_rescued_match_that_a_rival_beats_is_solved_again(x64, margin, kept):
    """Detection 0 fits better what 1 was rescued onto (method.md#gating-fragile)."""
    frame = visual_frame([{0: 0.80, 1: 0.77}, {0: 0.30, 1: 0.705}], context={1: backed(0.05)})
    t = dataclasses.replace(Thresholds(), **ALONE)
    stability = dataclasses.replace(t.stability, alternative_margin=margin)
    d = decide_frames([frame], [dataclasses.replace(t, stability=stability)]).decisions
    assert d.assigned_id[0, :2].tolist() == [0, 1]
    assert d.guarded_id[0, :2].tolist() == kept
