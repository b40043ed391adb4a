"""What a fresh process takes until its first identity: CPU seconds and peak memory.

    python benchmarks/cold_start.py                    the default configuration
    python benchmarks/cold_start.py --configs default published --json rows.json

For every configuration: with an empty folder of programs, again with what that left there, and with
another frame size. Counted by the operating system for the whole process, the interpreter included;
`compile_s` is the wall time that the tracker waited for programs.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from benchmarks.rows import show_rows

ROOT = Path(__file__).resolve().parent.parent
SIZES = ("640x480", "800x600")
_PROCESS = """
import json, sys
import numpy as np
import remind_jax as rj

config, width, height = sys.argv[1], int(sys.argv[2]), int(sys.argv[3])
random = np.random.default_rng(0)
image = random.integers(0, 255, (height, width, 3), np.uint8)
masks = np.zeros((6, height, width), bool)
for number, mask in enumerate(masks):
    top, left = divmod(number, 3)
    mask[40 + 200 * top : 190 + 200 * top, 30 + 200 * left : 180 + 200 * left] = True
tracker = rj.Tracker(config)
tracks = tracker.update(image, rj.Detections.create(masks, labels=["mug"] * len(masks)))
assert len(tracks) == len(masks)
print(json.dumps({"compile_s": tracker.compile_s}))
"""


def start(config: str, size: str, programs: Path) -> dict[str, float]:
    """One process with its programs in a folder."""
    settings = {"REMIND_PROGRAMS": str(programs), "JAX_COMPILATION_CACHE_DIR": ""}
    process = subprocess.Popen(
        [sys.executable, "-c", _PROCESS, config, *size.split("x")],
        cwd=ROOT,
        env=os.environ | settings,
        stdout=subprocess.PIPE,
    )
    assert process.stdout is not None
    told = process.stdout.read()
    _, status, used = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode:
        raise SystemExit(f"the process with configuration {config} ended with {status}")
    # Kilobytes on Linux, bytes on macOS.
    unit = 1 if sys.platform == "darwin" else 1024
    return {
        "cpu_s": used.ru_utime + used.ru_stime,
        "peak_gb": used.ru_maxrss * unit / 1e9,
        **json.loads(told),
    }


def measure(configs: list[str], repeats: int) -> Iterator[dict[str, Any]]:
    """Every case so many times; rows give the median by CPU seconds."""

    def median(rows: list[dict[str, float]]) -> dict[str, float]:
        return sorted(rows, key=lambda row: row["cpu_s"])[len(rows) // 2]

    for config in configs:
        cases: dict[str, list[dict[str, float]]] = {}
        for _ in range(repeats):
            with tempfile.TemporaryDirectory() as folder:
                for case, size in (
                    ("empty", SIZES[0]),
                    ("warm", SIZES[0]),
                    ("another size", SIZES[1]),
                    ("another size, warm", SIZES[1]),
                ):
                    cases.setdefault(case, []).append(start(config, size, Path(folder)))
        for case, rows in cases.items():
            yield {"name": f"{config}, {case}", **median(rows)}


def main() -> None:
    """Parses the command line, measures and prints."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--configs", nargs="+", default=["default"])
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--json", type=Path)
    given = parser.parse_args()
    show_rows(measure(given.configs, given.repeats), given.json)


if __name__ == "__main__":
    main()
