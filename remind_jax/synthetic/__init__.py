"""Procedural rooms, objects and camera paths with ground truth, seeded."""

from remind_jax.synthetic.davis import record_davis as record_davis
from remind_jax.synthetic.davis import write_davis as write_davis
from remind_jax.synthetic.options import LookalikeGroup as LookalikeGroup
from remind_jax.synthetic.options import SceneOptions as SceneOptions
from remind_jax.synthetic.options import demo_options as demo_options
from remind_jax.synthetic.rendering import RenderedSequence as RenderedSequence
from remind_jax.synthetic.rendering import make_scene as make_scene
from remind_jax.synthetic.rendering import render as render
from remind_jax.synthetic.rendering import render_sequence as render_sequence
from remind_jax.synthetic.scene import CameraPath as CameraPath
from remind_jax.synthetic.scene import Furniture as Furniture
from remind_jax.synthetic.scene import Light as Light
from remind_jax.synthetic.scene import Look as Look
from remind_jax.synthetic.scene import Placement as Placement
from remind_jax.synthetic.scene import Pose as Pose
from remind_jax.synthetic.scene import Room as Room
from remind_jax.synthetic.scene import Scene as Scene
from remind_jax.synthetic.scene import SceneObject as SceneObject
from remind_jax.synthetic.scene import Sensor as Sensor
