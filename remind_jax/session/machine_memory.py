"""What memory this machine has, and what fits into it."""

from __future__ import annotations

import contextlib
import ctypes
import dataclasses
import os
from pathlib import Path

import jax

from remind_jax.errors import SourceError
from remind_jax.method import Method
from remind_jax.static import GROWTH_STEP, MOST_DETECTIONS, OBJECTS_PER_DETECTION, Static

BUDGET_SHARE = 0.75  # of the memory of the device; the rest is for frames, masks and the network
GIB = 2**30
MAX_FRAME_BYTES = 1 << 29  # what follows from one frame may take so much (`most_detections`)
MAX_UNCOUNTED = 2048  # detections in a frame, of methods that do not count their bytes
_GROUP_LIMIT = Path("/sys/fs/cgroup/memory.max")  # of a container, where there is one


def check_room(method: Method, static: Static) -> None:
    """Makes sure that memory and step of a method fit into three quarters of the device's memory.

    Raises:
      SourceError: If they do not.
    """
    if method.host.count_bytes is None:
        return
    needed, total = method.host.count_bytes(static), device_bytes()
    if total and needed > BUDGET_SHARE * total:
        raise SourceError(
            f"room for {static.num_detections} detections in a frame and {static.num_objects} "
            f"objects takes about {needed / GIB:.1f} GiB, and {BUDGET_SHARE * total / GIB:.1f} GiB "
            "of this machine's memory may be used; keep fewer detections (best ones or "
            "wanted classes only), or start with an empty memory"
        )


def most_detections(method: Method, static: Static, feature_dim: int) -> int:
    """How many detections a frame may have, so that no single frame takes much memory.

    Args:
      static: Capacities that were chosen; what there is room for is allowed.
      feature_dim: Width of the features, where `static` does not say it yet.
    """
    if method.host.count_bytes is None:
        return max(static.num_detections, MAX_UNCOUNTED)
    empty = dataclasses.replace(
        static, num_objects=1, num_pending=1, feature_dim=static.feature_dim or feature_dim
    )
    most = static.num_detections
    while most * GROWTH_STEP <= MOST_DETECTIONS:
        needed = most * GROWTH_STEP
        objects = OBJECTS_PER_DETECTION * needed
        room = empty.grow(num_detections=needed, num_objects=objects, num_pending=needed)
        if method.host.count_bytes(room) > MAX_FRAME_BYTES:
            break
        most = needed
    return most


def device_bytes() -> int:
    """Memory of the device that steps run on, 0 where that is not known."""
    stats = jax.local_devices()[0].memory_stats()
    if stats and stats.get("bytes_limit"):
        return int(stats["bytes_limit"])
    if jax.default_backend() != "cpu" or not hasattr(os, "sysconf"):
        return 0
    total = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    try:
        return min(total, int(_GROUP_LIMIT.read_text(encoding="ascii")))
    except (OSError, ValueError):  # no such group, or "max"
        return total


def return_freed_memory() -> None:
    """Gives what was freed back to the system, where its C library can: that of GNU."""
    with contextlib.suppress(AttributeError, OSError, TypeError):
        ctypes.CDLL(None).malloc_trim(0)
