"""Whether larger capacities fit this machine, asked before anything is compiled or allocated."""

from __future__ import annotations

import os
from pathlib import Path

import jax

from remind_jax.errors import SourceError
from remind_jax.method import Method
from remind_jax.static import Static

BUDGET_SHARE = 0.75  # of the memory of the device; the rest is for frames, masks and the network
GIB = 2**30
_GROUP_LIMIT = Path("/sys/fs/cgroup/memory.max")  # of a container, where there is one


def check_room(method: Method, static: Static) -> None:
    """Makes sure that memory and step of a method fit into three quarters of the device's memory.

    Raises:
      SourceError: If they do not.
    """
    if method.count_bytes is None:
        return
    needed, total = method.count_bytes(static), device_bytes()
    if total and needed > BUDGET_SHARE * total:
        raise SourceError(
            f"room for {static.num_detections} detections in a frame and {static.num_objects} "
            f"objects takes about {needed / GIB:.1f} GiB, and {BUDGET_SHARE * total / GIB:.1f} GiB "
            "of this machine's memory may be used; keep fewer detections (best ones or "
            "wanted classes only), or start with an empty memory"
        )


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
