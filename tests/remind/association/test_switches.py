"""Switches that are not as shipped, against the original.

Rules: method.md#context-allowed, method.md#identity-stability, method.md#ambiguity,
method.md#provisional.

Settings are read as the original writes them, so that the import is tested as well.
"""

from typing import Any

import numpy as np

from remind_jax.config import Config
from remind_jax.config.dotted_keys import nest
from remind_jax.remind.thresholds import Thresholds
from tests.golden.load import load_expected
from tests.remind.association.frozen_frames import load_frames, load_settings
from tests.remind.association.tables import Verdict, decide_frames

STABILITY = "association.matching.hungarian.identity_stability"
SWITCHES = {
    "association.matching.neighbor_sets_influence.allow_status",
    "association.ambiguous_tracks.allow_status",
    "association.provisional_new.allow_status",
    f"{STABILITY}.fragile_gate_reasons",
    f"{STABILITY}.component_max_size",
}


def read(settings: dict[str, Any]) -> Thresholds:
    return Config.from_reference(nest(settings)).thresholds


def decided(verdict: Verdict) -> dict[str, Any]:
    d = verdict.decisions
    return {
        "outcome": d.outcome,
        "reason": d.reason,
        "object": d.object_id,
        "option": d.option_id,
    }


def test_frozen_frames_with_other_switches(x64):
    """75 frames; in each the switch decides what becomes of a detection."""
    frames, settings = load_frames("switches"), load_settings("switches")
    shipped = [
        {key: value for key, value in given.items() if key not in SWITCHES} for given in settings
    ]
    found = decided(decide_frames(frames, [read(given) for given in settings]))
    before = decided(decide_frames(frames, [read(given) for given in shipped]))
    expected = load_expected("association/switches")
    changed = np.zeros(len(frames), bool)
    for name, values in found.items():
        np.testing.assert_array_equal(values, expected[name], name)
        changed |= np.any((values != before[name]).reshape(len(frames), -1), axis=1)
    assert changed.all(), np.flatnonzero(~changed)
