"""Online long-term re-identification of object instances, in JAX.

    import remind_jax as rj

    result = rj.run("rooms.mp4", detector="yolo11n-seg.onnx", out="runs/rooms")

Names are imported when they are first used, so that `import remind_jax` stays fast.
"""

from __future__ import annotations

import os

import lazy_loader

# The compiler's alarms ("Very slow compile? If you want to file a bug, ...") are meant for its own
# developers and are written past Python; what really fails is raised as well. The library reads
# this once, when it is loaded, so it comes before anything that imports JAX.
os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "3")

__version__ = "0.1.0"

# `__init__.pyi` says which names there are, here and to type checkers.
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
