"""Procedural rooms, objects and camera paths with ground truth, seeded.

Look-alikes on tables and shelves, a camera that leaves, lamps that go down, a return minutes later
from another side: `render_sequence(demo_options())` gives it as frames with exact masks.
"""

from remind_jax.synthetic.davis import write_davis
from remind_jax.synthetic.detector_noise import DetectorNoise, add_detector_noise
from remind_jax.synthetic.options import LookalikeGroup, SceneOptions, demo_options
from remind_jax.synthetic.rendering import RenderedSequence, make_scene, render, render_sequence
from remind_jax.synthetic.scene import (
    CameraPath,
    Furniture,
    Light,
    Look,
    Placement,
    Pose,
    Room,
    Scene,
    SceneObject,
    Sensor,
)

__all__ = [
    "CameraPath",
    "DetectorNoise",
    "Furniture",
    "Light",
    "Look",
    "LookalikeGroup",
    "Placement",
    "Pose",
    "RenderedSequence",
    "Room",
    "Scene",
    "SceneObject",
    "SceneOptions",
    "Sensor",
    "add_detector_noise",
    "demo_options",
    "make_scene",
    "render",
    "render_sequence",
    "write_davis",
]
