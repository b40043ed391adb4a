"""Unmatched detections that may be known after all (method.md#provisional)."""

from __future__ import annotations

import dataclasses
from typing import Any

import pytest

from remind_jax.decision import Outcome, Reason
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


def test_without_context_moderate_similarity_is_new_unless_allowed(x64):
    rows = [{0: 0.70, 1: 0.68}]
    assert last(rows)[0] is NEW
    assert last(rows, require_context=False) == (PROVISIONAL, [], 0)


def test_a_near_miss_of_an_object_that_is_taken(x64):
    assert last([{0: 0.95}, {0: 0.74}]) == (PROVISIONAL, [0], 1)


def test_support_of_context(x64):
    assert last([{0: 0.64, 1: 0.30}], {0: 0.05}) == (PARENT, [0], 0)
    # A rival without support makes the parent doubtful,
    assert last([{0: 0.64, 1: 0.63}], {0: 0.05}) == (PROVISIONAL, [0], 0)
    assert last([{0: 0.53, 1: 0.30}], {0: 0.05}) == (NEW, [], 0)  # below 0.60 with the bonus
    # one that looks better all the more.
    assert last([{0: 0.62, 1: 0.70}], {0: 0.05}) == (PROVISIONAL, [0], 0)
    assert last([{0: 0.95}, {0: 0.70}], {0: 0.05}) == (PROVISIONAL, [0], 1)


def test_two_supported_objects_make_it_ambiguous(x64):
    taken = [{0: 0.95, 1: 0.20}, {0: 0.20, 1: 0.95}]
    outcome, named, blocked = last([*taken, {0: 0.70, 1: 0.69}], {0: 0.03, 1: 0.03})
    assert (outcome, named, blocked) == (AMBIGUOUS, [0, 1], 0)


@pytest.mark.parametrize(("most", "named"), [(1, [0, 1]), (2, [0, 1]), (3, [0, 1, 2])])
def test_beside_a_taken_support_further_ones_are_named(x64, most, named):
    """More objects are named: at least one more, up to the limit."""
    rows = [{0: 0.97, 1: 0.1, 2: 0.1}, {0: 0.80, 1: 0.64, 2: 0.63}]
    outcome, found, _ = last(rows, dict.fromkeys(range(3), 0.02), max_support=most)
    assert outcome is AMBIGUOUS
    assert found == named


def test_reasons(x64):
    rows = {
        Reason.UNCERTAIN_PARENT: ([{0: 0.74}], {}),
        Reason.UNCERTAIN_KNOWN_BLOCKED: ([{0: 0.95}, {0: 0.74}], {}),
        Reason.KNOWN_BUT_AMBIGUOUS_CONTEXTUAL_FALLBACK: (
            [{0: 0.95, 1: 0.30}, {0: 0.80, 1: 0.66}],
            {0: backed(0.05), 1: backed(0.05)},
        ),
    }
    t = dataclasses.replace(
        Thresholds(), competition=dataclasses.replace(Thresholds().competition, enabled=False)
    )
    frames = [visual_frame(table, context=context) for table, context in rows.values()]
    d = decide_frames(frames, [t] * len(frames)).decisions
    for row, (reason, (table, _)) in enumerate(rows.items()):
        assert Reason(d.reason[row, len(table) - 1]) is reason


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
