"""TrackEval as a process of its own, so that it can live in another environment.

Started by `benchmarks/metrics.py` with a folder that holds `gt.txt` and `pred.txt`. For every line
on standard input it evaluates them once and answers with one JSON line: milliseconds and scores.
"""

import contextlib
import json
import shutil
import sys
import time
from pathlib import Path

import numpy as np

with contextlib.redirect_stdout(sys.stderr):
    import trackeval  # pyright: ignore[reportMissingImports]


def lay_out(folder: Path) -> tuple[Path, Path]:
    """Copies the two files to where TrackEval's MOTChallenge reader looks for them."""
    gt, trackers = folder / "peer_gt", folder / "peer_trackers"
    (gt / "bench-train" / "scene" / "gt").mkdir(parents=True, exist_ok=True)
    (trackers / "bench-train" / "tracker" / "data").mkdir(parents=True, exist_ok=True)
    shutil.copyfile(folder / "gt.txt", gt / "bench-train" / "scene" / "gt" / "gt.txt")
    data = trackers / "bench-train" / "tracker" / "data"
    shutil.copyfile(folder / "pred.txt", data / "scene.txt")
    return gt, trackers


def main() -> None:
    folder, num_frames = Path(sys.argv[1]), int(sys.argv[2])
    gt, trackers = lay_out(folder)
    with contextlib.redirect_stdout(sys.stderr):
        dataset = trackeval.datasets.MotChallenge2DBox(
            {
                "GT_FOLDER": str(gt),
                "TRACKERS_FOLDER": str(trackers),
                "BENCHMARK": "bench",
                "SEQ_INFO": {"scene": num_frames},
                "DO_PREPROC": False,
                "PRINT_CONFIG": False,
            }
        )
        metrics = {
            "HOTA": trackeval.metrics.HOTA(),
            "CLEAR": trackeval.metrics.CLEAR({"PRINT_CONFIG": False}),
            "Identity": trackeval.metrics.Identity({"PRINT_CONFIG": False}),
        }
    for _ in sys.stdin:
        start = time.perf_counter()
        raw = dataset.get_raw_seq_data("tracker", "scene")
        data = dataset.get_preprocessed_seq_data(raw, "pedestrian")
        times = {"load": time.perf_counter() - start}
        scores = {}
        for name, metric in metrics.items():
            start = time.perf_counter()
            scores |= metric.eval_sequence(data)
            times[name] = time.perf_counter() - start
        print(
            json.dumps(
                {
                    "ms": {name: 1e3 * value for name, value in times.items()},
                    "scores": {name: float(np.mean(value)) for name, value in scores.items()},
                }
            ),
            flush=True,
        )


if __name__ == "__main__":
    main()
