"""Detections that could be one of several known objects (method.md#ambiguity)."""

from __future__ import annotations

import dataclasses
from typing import Any

import pytest

from remind_jax.decision import Outcome, Reason
from remind_jax.remind.thresholds import Thresholds
from tests.remind.association.tables import backed, decide_frames, visual_frame


def options(
    row: dict[int, float], supported: tuple[int, ...] = (), **changed: Any
) -> tuple[list[int], Reason]:
    """What a single detection could be, and why; no options where it is decided."""
    t = Thresholds()
    t = dataclasses.replace(
        t,
        ambiguous=dataclasses.replace(t.ambiguous, **changed),
        provisional=dataclasses.replace(t.provisional, enabled=False),
    )
    frame = visual_frame([row], context=dict.fromkeys(supported, backed(0.05)))
    d = decide_frames([frame], [t]).decisions
    named = [int(o) for o in d.option_id[0, 0] if o >= 0]
    assert (d.outcome[0, 0] == Outcome.AMBIGUOUS) == bool(named)
    return named, Reason(d.reason[0, 0])


MATCHED = (Reason.KNOWN_BUT_AMBIGUOUS_VISUAL_MATCH, Reason.KNOWN_BUT_AMBIGUOUS_MATCH)


@pytest.mark.parametrize(
    ("row", "supported", "changed", "named"),
    [
        ({0: 0.80, 1: 0.73}, (), {}, [0, 1]),
        ({0: 0.80, 1: 0.7195}, (), {}, []),
        ({0: 0.80, 1: 0.79, 2: 0.775}, (), {}, [0, 1, 2]),
        ({0: 0.80, 1: 0.79, 2: 0.785, 3: 0.775}, (), {}, [0, 1, 2]),  # at most three ties
        ({0: 0.80, 1: 0.73}, (), {"enabled": False}, []),
        ({0: 0.80, 1: 0.73}, (), {"override_match": False}, []),
        ({0: 0.80, 1: 0.73}, (), {"visual_fallback": False}, []),
        ({0: 0.80, 1: 0.73}, (), {"visual_fallback": False, "supported_only": False}, []),
        (
            {0: 0.80, 1: 0.73},
            (),
            {"visual_fallback": False, "supported_only": False, "require_context": False},
            [0, 1],
        ),
        ({0: 0.80, 1: 0.73}, (), {"visual_min_top": 0.81}, []),
        ({0: 0.80, 1: 0.79, 2: 0.775}, (), {"visual_max": 2}, [0, 1]),
        ({0: 0.80, 1: 0.79, 2: 0.775}, (), {"max_candidates": 2}, []),  # three are too many
        ({0: 0.80}, (), {}, []),
        ({0: 0.84, 1: 0.78}, (1,), {}, [0, 1]),  # unsupported match, supported rival
        ({0: 0.92, 1: 0.76}, (1,), {}, []),  # too far apart
        ({0: 0.90, 1: 0.86, 2: 0.70}, (0, 1), {}, [0, 1]),
    ],
)
def test_matched_detections(x64, row, supported, changed, named):
    found, reason = options(row, supported, **changed)
    assert found == named
    assert not named or reason in MATCHED
