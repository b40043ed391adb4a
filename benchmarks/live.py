"""A camera that is faster than the tracker: how old is what is shown, and does memory grow?

    python benchmarks/live.py [--minutes 10] [--detector-ms 100] [--json OUT]

A generated camera in a process of its own sends 30 frames a second over HTTP and breaks off once.
The detector waits, as if a device computed. A client looks at the live page all the time. Memory is
that of this process (resident).
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import tempfile
import threading
import time
import urllib.request
from pathlib import Path
from typing import Any

import numpy as np

import remind_jax as rj
from tests.sources import cameras

FPS = 30.0


def send(address: Any, gone_at_s: float) -> None:
    """The process of the camera, which is gone for two seconds once."""
    with cameras.Camera(FPS) as camera:
        address.put(camera.url)
        time.sleep(gone_at_s)
        camera.switch_off()
        time.sleep(2)
        camera.switch_on()
        time.sleep(1e6)


def resident_mib() -> float:
    """Memory of this process."""
    for line in Path("/proc/self/status").read_text().splitlines():
        if line.startswith("VmRSS:"):
            return int(line.split()[1]) / 1024
    raise RuntimeError("the system does not say how much memory is used")


def watch(over: threading.Event, every_s: float, found: list[tuple[float, float]]) -> None:
    """Takes down seconds and memory until it is over."""
    start = time.monotonic()
    while not over.wait(every_s):
        found.append((time.monotonic() - start, resident_mib()))


def look(over: threading.Event, address: str, counts: dict[str, int]) -> None:
    """Looks at the page as a browser does."""
    version = -1
    while not over.is_set():
        try:
            with urllib.request.urlopen(f"{address}state.json?after={version}", timeout=10) as one:
                version = json.load(one)["version"]
            with urllib.request.urlopen(f"{address}frame.jpg", timeout=10) as one:
                counts["pictures"] = counts.get("pictures", 0) + bool(one.read())
        except OSError:
            over.wait(0.5)


def main() -> None:
    """Runs and prints one JSON object."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--minutes", type=float, default=10.0)
    parser.add_argument("--detector-ms", type=float, default=100.0)
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()

    def detect(image: np.ndarray) -> dict[str, Any]:
        time.sleep(options.detector_ms / 1000)
        return cameras.detect(image)

    context, over = multiprocessing.get_context("spawn"), threading.Event()
    address = context.Queue()
    camera = context.Process(target=send, args=(address, 20 * options.minutes), daemon=True)
    camera.start()
    memory: list[tuple[float, float]] = []
    counts: dict[str, int] = {}
    threads = [threading.Thread(target=watch, args=(over, 5.0, memory))]

    def on_live(page: str) -> None:
        threads.append(threading.Thread(target=look, args=(over, page, counts)))
        threads[-1].start()

    threads[0].start()
    with tempfile.TemporaryDirectory() as folder:
        began = time.process_time()
        result = rj.run(
            address.get(),
            detector=detect,
            announce_after=1,
            out=Path(folder) / "run",
            duration=60 * options.minutes,
            live="127.0.0.1:0",
            on_live=on_live,
            progress=False,
        )
        cpu_s = time.process_time() - began
    over.set()
    for thread in threads:
        thread.join()
    camera.terminate()
    report = summarize(result, memory) | {"cpu_s": cpu_s, "pictures_looked_at": counts["pictures"]}
    print(json.dumps(report, indent=1))
    if options.json is not None:
        options.json.write_text(json.dumps(report, indent=1) + "\n")


def summarize(result: rj.Result, memory: list[tuple[float, float]]) -> dict[str, Any]:
    """Ages in frames of the tracker's own time, frames passed over, and memory over time."""
    stages = [times for name, times in result.timings_ms.items() if name not in ("age", "wait")]
    own_ms = np.sum(stages, axis=0)
    ages_ms = np.array(result.timings_ms["age"])
    frames_old = ages_ms / np.median(own_ms)
    times, sizes = np.array(memory).T
    second_half = sizes[times > times[-1] / 2]
    return {
        "frames": len(result),
        "passed_over": sum(skipped.count for skipped in result.skipped),
        "identities": len(result.objects()),
        "own_ms_median": float(np.median(own_ms)),
        "age_ms": [float(np.percentile(ages_ms, q)) for q in (50, 95, 100)],
        "age_in_own_frames": [float(np.percentile(frames_old, q)) for q in (50, 95, 100)],
        "share_within_2_median_own_frames": float(np.mean(frames_old <= 2)),
        "age_in_its_own_frame": [float(np.percentile(ages_ms / own_ms, q)) for q in (50, 95, 100)],
        "memory_mib": [
            [round(t), round(size, 1)] for t, size in memory[:: max(1, len(memory) // 20)]
        ],
        "memory_growth_in_second_half_mib": float(second_half[-1] - second_half[0]),
        "events": [event.message for event in result.events],
    }


if __name__ == "__main__":
    main()
