"""Sweeps: thousands of settings over many scenes, scored on the device."""

from __future__ import annotations

from remind_jax.sweeps.bench import SceneBench as SceneBench
from remind_jax.sweeps.bench import sweep as sweep
from remind_jax.sweeps.cross_validation import cross_validate as cross_validate
from remind_jax.sweeps.result import Standing as Standing
from remind_jax.sweeps.result import SweepResult as SweepResult
from remind_jax.sweeps.scene_arrays import StackedScene as StackedScene
from remind_jax.sweeps.scene_arrays import stack_scene as stack_scene
from remind_jax.sweeps.search import search as search
from remind_jax.sweeps.sensitivity import PAPER_SPACE as PAPER_SPACE
from remind_jax.sweeps.sensitivity import PLUS_SPACE as PLUS_SPACE
from remind_jax.sweeps.sensitivity import move_one_at_a_time as move_one_at_a_time
from remind_jax.sweeps.settings import Setting as Setting
from remind_jax.sweeps.settings import draw as draw
from remind_jax.sweeps.settings import grid as grid
from remind_jax.sweeps.settings import parse_values as parse_values
from remind_jax.sweeps.settings import read_settings as read_settings
from remind_jax.sweeps.settings import stack as stack
from remind_jax.sweeps.worker import Progress as Progress
