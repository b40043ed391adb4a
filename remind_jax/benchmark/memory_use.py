"""Memory of this process as the operating system measures it."""

from __future__ import annotations

import contextlib
import ctypes
import math
import os
import resource
import subprocess
import sys
from pathlib import Path

_MIB = 1024 * 1024
_STATUS = Path("/proc/self/status")
_CLEAR = Path("/proc/self/clear_refs")
_RESET_PEAK = "5"  # see proc(5)


def reset_peak() -> bool:
    """Starts the peak of resident memory anew; False where the system cannot: it only grows.

    What a compiler has freed, gigabytes, first goes back to the system.
    """
    with contextlib.suppress(OSError, AttributeError):
        ctypes.CDLL(None).malloc_trim(0)  # glibc only
    with contextlib.suppress(OSError):
        _CLEAR.write_text(_RESET_PEAK)
        return True
    return False


def peak_rss_mib() -> float:
    """Largest resident memory since `reset_peak`, in MiB."""
    with contextlib.suppress(OSError, ValueError, IndexError):
        for line in _STATUS.read_text().splitlines():
            if line.startswith("VmHWM:"):
                return int(line.split()[1]) / 1024
    largest = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return largest / _MIB if sys.platform == "darwin" else largest / 1024


def device_memory_mib() -> float:
    """Memory that this process holds on NVIDIA devices, in MiB, by their driver; NaN without one.

    JAX gives memory back to the driver only at its end, so this is the peak so far; it reserves
    three quarters of a device at its start unless XLA_PYTHON_CLIENT_PREALLOCATE is false.
    """
    query = ["nvidia-smi", "--query-compute-apps=pid,used_memory", "--format=csv,noheader,nounits"]
    try:
        listed = subprocess.run(query, capture_output=True, text=True, check=True, timeout=20)
    except (OSError, subprocess.SubprocessError):
        return math.nan
    used = 0.0
    for line in listed.stdout.splitlines():
        pid, _, mib = line.partition(",")
        if pid.strip() == str(os.getpid()) and mib.strip().isdigit():
            used += float(mib)
    return used or math.nan
