"""Online long-term re-identification of object instances, in JAX.

    import remind_jax as rj

    result = rj.run("rooms.mp4", detector="yolo11n-seg.onnx", out="runs/rooms")

Names are imported when they are first used, so that `import remind_jax` stays fast.
"""

from __future__ import annotations

import lazy_loader

__version__ = "0.1.0"

# `__init__.pyi` says which names there are, here and to type checkers.
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
