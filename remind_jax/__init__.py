"""Online long-term re-identification of object instances, in JAX.

    import remind_jax as rj

    result = rj.run("rooms.mp4", detector="yolo11n-seg.onnx", out="runs/rooms")

Names are imported when they are first used, so that `import remind_jax` stays fast.
"""

from __future__ import annotations

import importlib
import os
from typing import TYPE_CHECKING, Any

# The compiler's alarms ("Very slow compile? If you want to file a bug, ...") are meant for its own
# developers and are written past Python; what really fails is raised as well. The library reads
# this once, when it is loaded, so it comes before anything that imports JAX.
os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "3")

if TYPE_CHECKING:
    from remind_jax import sweeps as sweeps
    from remind_jax.config import Config as Config
    from remind_jax.config import load_config as load_config
    from remind_jax.decision import Decisions as Decisions
    from remind_jax.decision import Outcome as Outcome
    from remind_jax.errors import RemindError as RemindError
    from remind_jax.frame import Detections as Detections
    from remind_jax.frame import Frame as Frame
    from remind_jax.metrics import compare as compare
    from remind_jax.metrics import evaluate as evaluate
    from remind_jax.observation import FrameFeats as FrameFeats
    from remind_jax.observation import Masks as Masks
    from remind_jax.outputs.result import Result as Result
    from remind_jax.remind.state import TrackerState as TrackerState
    from remind_jax.remind.thresholds import Thresholds as Thresholds
    from remind_jax.remind.tracker import init as init
    from remind_jax.remind.tracker import step as step
    from remind_jax.session.live import Tracker as Tracker
    from remind_jax.session.run import run as run
    from remind_jax.sources import Sampling as Sampling
    from remind_jax.sources import open_source as open_source
    from remind_jax.static import Static as Static
    from remind_jax.sweeps import sweep as sweep
    from remind_jax.tracks import Tracks as Tracks

__version__ = "0.1.0"

_HOMES = {
    "Config": "config",
    "Decisions": "decision",
    "Detections": "frame",
    "Frame": "frame",
    "FrameFeats": "observation",
    "Masks": "observation",
    "Outcome": "decision",
    "RemindError": "errors",
    "Result": "outputs.result",
    "Sampling": "sources",
    "Static": "static",
    "Thresholds": "remind.thresholds",
    "Tracker": "session.live",
    "TrackerState": "remind.state",
    "Tracks": "tracks",
    "compare": "metrics",
    "evaluate": "metrics",
    "init": "remind.tracker",
    "load_config": "config",
    "open_source": "sources",
    "run": "session.run",
    "step": "remind.tracker",
    "sweep": "sweeps",
}

__all__ = sorted(_HOMES)


def __getattr__(name: str) -> Any:
    if name == "sweeps":
        return importlib.import_module("remind_jax.sweeps")
    if name not in _HOMES:
        raise AttributeError(f"module 'remind_jax' has no attribute {name!r}")
    home = importlib.import_module(f"remind_jax.{_HOMES[name]}")
    value = getattr(home, name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return [*globals(), *_HOMES]
