"""A sweep small enough for tests in other processes."""

import dataclasses

from remind_jax.config import Config
from remind_jax.sweeps import draw
from tests import tiny_world as world

CONFIG = dataclasses.replace(Config(), thresholds=world.THRESHOLDS, static=world.STATIC)
SPACE = {
    "matching.match": (0.5, 0.9),
    "appearance.duplicate": (0.6, 0.95),
    "diagnosis.close": (0.01, 0.2),
    "influence.enabled": (False, True),
    "known_sets.enabled": (False, True),
    "perception.trim_keep": (0.5, 0.7, 0.9),
}
SETTINGS = draw(SPACE, 7, seed=1)
SCENES = [world.make_scene(9, seed=seed) for seed in (3, 4)]
