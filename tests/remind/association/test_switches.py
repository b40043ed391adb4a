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
from tests.remind.association.tables import decide_frames

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


def test_frozen_frames_with_other_switches(x64):
    """75 frames; in each the switch decides what becomes of a detection."""
    frames, settings = load_frames("switches"), load_settings("switches")
    shipped = [
        {key: value for key, value in given.items() if key not in SWITCHES} for given in settings
    ]
    found, before = (
        decide_frames(frames, [read(given) for given in tried]).decisions
        for tried in (settings, shipped)
    )
    expected = load_expected("association/switches")
    changed = np.zeros(len(frames), bool)
    for name in ("outcome", "reason", "object", "option"):
        field = f"{name}_id" if name in ("object", "option") else name
        values, shipped_values = getattr(found, field), getattr(before, field)
        np.testing.assert_array_equal(values, expected[name], name)
        changed |= np.any((values != shipped_values).reshape(len(frames), -1), axis=1)
    assert changed.all(), np.flatnonzero(~changed)
