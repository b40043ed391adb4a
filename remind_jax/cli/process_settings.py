"""What the command line, unlike the library, sets for its whole process."""

from __future__ import annotations

import contextlib
import os

from remind_jax.user_folders import user_cache_folder

CACHE_VARIABLE = "JAX_COMPILATION_CACHE_DIR"
_WORTH_KEEPING_S = 0.2  # compilations that took less are not kept


def keep_compiled_programs() -> None:
    """Lets JAX keep compiled programs between commands; `JAX_COMPILATION_CACHE_DIR` decides where.

    A folder that cannot be made costs only time.
    """
    import jax

    jax.config.update("jax_persistent_cache_min_compile_time_secs", _WORTH_KEEPING_S)
    if CACHE_VARIABLE in os.environ:
        return
    folder = user_cache_folder() / "compiled"
    with contextlib.suppress(OSError):
        folder.mkdir(parents=True, exist_ok=True)
        jax.config.update("jax_compilation_cache_dir", str(folder))


def silence_libraries() -> None:
    """Keeps OpenCV and FFmpeg from writing to the terminal; what fails is told by us."""
    import av.logging
    import cv2

    set_level = getattr(cv2, "setLogLevel", None) or cv2.utils.logging.setLogLevel
    set_level(0)
    av.logging.set_level(None)
