"""Unmatched detections that may be known after all (method.md#provisional)."""

from __future__ import annotations

import dataclasses
from typing import Any

import pytest

from remind_jax.decision import Outcome
from remind_jax.remind.thresholds import Thresholds
from tests.remind.association.tables import backed, decide_frames, visual_frame

PARENT, PROVISIONAL = Outcome.PROVISIONAL_PARENT, Outcome.PROVISIONAL_NEW
NEW, AMBIGUOUS = Outcome.NEW, Outcome.AMBIGUOUS


def last(
    rows: list[dict[int, float]], bonus: dict[int, float] | None = None, **changed: Any
) -> tuple[Outcome, list[int], int]:
    """Outcome of the last detection, the objects that it names, and how many others hold."""
    t = Thresholds()
    t = dataclasses.replace(
        t,
        provisional=dataclasses.replace(t.provisional, **changed),
        ambiguous=dataclasses.replace(t.ambiguous, enabled=False),
    )
    context = {slot: backed(value) for slot, value in (bonus or {}).items()}
    d = decide_frames([visual_frame(rows, context=context)], [t]).decisions
    n = len(rows) - 1
    named = [int(o) for o in d.option_id[0, n] if o >= 0]
    return Outcome(d.outcome[0, n]), named, int(d.option_blocked[0, n].sum())


@pytest.mark.parametrize(
    ("row", "changed", "expected"),
    [
        ({0: 0.74, 1: 0.50}, {}, (PARENT, [0], 0)),
        ({0: 0.7301}, {}, (PARENT, [0], 0)),
        ({0: 0.73}, {}, (NEW, [], 0)),  # 0.75 - 0.73 is just above 0.02 in doubles
        ({0: 0.74, 1: 0.67}, {}, (NEW, [], 0)),  # no clear winner
        ({0: 0.74, 1: 0.72}, {"visual_min_gap": 0.0}, (NEW, [], 0)),  # two are close
        (
            {0: 0.74, 1: 0.72},
            {"visual_min_gap": 0.0, "visual_max_close": 2},
            (PROVISIONAL, [0], 0),
        ),
        ({0: 0.74, 1: 0.50}, {"enabled": False}, (NEW, [], 0)),
        ({0: 0.74, 1: 0.50}, {"visual_fallback": False}, (NEW, [], 0)),
        ({0: 0.74, 1: 0.50}, {"visual_single_only": True}, (NEW, [], 0)),
        ({0: 0.74}, {"visual_single_only": True}, (PARENT, [0], 0)),
        ({0: 0.74, 1: 0.50}, {"visual_min_score": 0.745}, (NEW, [], 0)),
        ({0: 0.70, 1: 0.50}, {"visual_margin": 0.06}, (PARENT, [0], 0)),
        ({0: 0.50}, {}, (NEW, [], 0)),
    ],
)
def test_near_misses_of_the_match_threshold(x64, row, changed, expected):
    assert last([row], **changed) == expected


@pytest.mark.parametrize(("most", "named"), [(1, [0, 1]), (2, [0, 1]), (3, [0, 1, 2])])
def test_beside_a_taken_support_further_ones_are_named(x64, most, named):
    """More objects are named: at least one more, up to the limit."""
    rows = [{0: 0.97, 1: 0.1, 2: 0.1}, {0: 0.80, 1: 0.64, 2: 0.63}]
    outcome, found, _ = last(rows, dict.fromkeys(range(3), 0.02), max_support=most)
    assert outcome is AMBIGUOUS
    assert found == named


@pytest.mark.parametrize(
    ("context_required", "admitted", "outcome"),
    [(True, True, NEW), (False, True, PROVISIONAL), (False, False, NEW)],
)
def test_context_that_names_nobody_is_no_context(x64, context_required, admitted, outcome):
    """Object 0 is supported, but scores too little to be named (16, step 10)."""
    found = last(
        [{0: 0.64}], {0: 0.05}, min_candidate=0.75, require_context=context_required,
        from_strong=admitted,
    )  # fmt: skip
    assert found == (outcome, [], 0)
