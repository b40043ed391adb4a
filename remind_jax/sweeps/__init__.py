"""Sweeps: thousands of settings over many scenes, scored on the device."""

from __future__ import annotations

from remind_jax.sweeps.bench import SceneBench
from remind_jax.sweeps.cross_validation import cross_validate, cross_validate_choice
from remind_jax.sweeps.result import Standing, SweepResult
from remind_jax.sweeps.search import hyperband, search
from remind_jax.sweeps.sensitivity import (
    PAPER_SPACE,
    PLUS_SPACE,
    estimate_sobol,
    move_one_at_a_time,
)
from remind_jax.sweeps.settings import Setting, draw, grid, parse_values, read_settings
from remind_jax.sweeps.sweeping import sweep
from remind_jax.sweeps.worker import Progress

__all__ = [
    "PAPER_SPACE",
    "PLUS_SPACE",
    "Progress",
    "SceneBench",
    "Setting",
    "Standing",
    "SweepResult",
    "cross_validate",
    "cross_validate_choice",
    "draw",
    "estimate_sobol",
    "grid",
    "hyperband",
    "move_one_at_a_time",
    "parse_values",
    "read_settings",
    "search",
    "sweep",
]
