"""Sweeps: thousands of settings over many scenes, scored on the device."""

from remind_jax.sweep.result import Standing, SweepResult
from remind_jax.sweep.settings import Setting, draw, grid, parse_values, read_settings
from remind_jax.sweep.sweeping import Progress, sweep

__all__ = [
    "Progress",
    "Setting",
    "Standing",
    "SweepResult",
    "draw",
    "grid",
    "parse_values",
    "read_settings",
    "sweep",
]
