"""Sweeps: thousands of settings over many scenes, scored on the device.

The package can be called as its function `sweep`, so that `remind_jax.sweep` is both.
"""

from __future__ import annotations

import sys
from types import ModuleType
from typing import Any

from remind_jax.sweep.bench import SceneBench
from remind_jax.sweep.cross_validation import cross_validate, cross_validate_choice
from remind_jax.sweep.result import Standing, SweepResult
from remind_jax.sweep.search import hyperband, search
from remind_jax.sweep.sensitivity import (
    PAPER_SPACE,
    PLUS_SPACE,
    estimate_sobol,
    move_one_at_a_time,
)
from remind_jax.sweep.settings import Setting, draw, grid, parse_values, read_settings
from remind_jax.sweep.sweeping import sweep
from remind_jax.sweep.worker import Progress

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


class _CallablePackage(ModuleType):
    def __call__(self, *args: Any, **options: Any) -> SweepResult:
        """As the function `sweep`."""
        return sweep(*args, **options)


sys.modules[__name__].__class__ = _CallablePackage
