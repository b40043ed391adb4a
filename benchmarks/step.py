"""Time of one tracker step on a golden sequence, beside the original in the same run, alternating.

    python benchmarks/step.py [--sequence FOLDER/NAME] [--variant default] [--json OUT]
    python benchmarks/step.py --profile 10     kernels of the last ten frames instead of times

Without network: features are given. Rows: the whole frame (masks to memory), and our stages. The
original is looked for in the work tree that REMIND_ORIGINAL names. Frames come from
`FOLDER/inputs/NAME.npz`; settings of variants other than the shipped ones, which are `default`,
from `FOLDER/traces/NAME/VARIANT.npz`.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any, cast

import jax
import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from benchmarks.kernels import make_rows, record
from benchmarks.rows import show_rows
from remind_jax.config import Config
from remind_jax.frame import Detections, Frame
from remind_jax.masks.reduction import pad_masks
from remind_jax.observation import FrameFeats
from remind_jax.remind.perception.description import describe
from remind_jax.session.live import Tracker
from tests.golden import load

DEFAULT_SEQUENCE = load.ROOT / "two_rooms"
WHOLE_FRAME = "masks to memory"
STAGES = ("masks", "describe", "decide and remember")

_describe = jax.jit(describe, static_argnums=2)


class Peer:
    """The original in its own process; absent if there is no work tree of it."""

    def __init__(self, tree: str | None, root: Path, name: str, overrides: dict, classes: list):
        self._process: subprocess.Popen[str] | None = None
        if tree:
            worker = Path(__file__).with_name("original_peer.py")
            self._process = subprocess.Popen(
                [sys.executable, str(worker), tree, str(root), name],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                text=True,
            )
            self._write(json.dumps({"overrides": overrides, "classes": classes}))

    def step_ms(self) -> float | None:
        """Steps the next frame; its milliseconds, or None if there is no peer."""
        if self._process is None:
            return None
        assert self._process.stdout is not None
        self._write("step")
        answer = self._process.stdout.readline()
        if not answer:
            raise SystemExit("the original stopped; its message stands above")
        return sum(json.loads(answer).values())

    def close(self) -> None:
        """Ends the process."""
        if self._process is not None:
            self._process.kill()
            self._process.wait()

    def _write(self, line: str) -> None:
        assert self._process is not None
        assert self._process.stdin is not None
        self._process.stdin.write(line + "\n")
        self._process.stdin.flush()


def read_settings(root: Path, name: str, variant: str) -> tuple[dict[str, Any], list[str]]:
    """Overrides of the original's configuration, and the classes in order of their ids."""
    if (root / "traces" / name / f"{variant}.npz").exists():
        info = load.load_trace(name, variant, root).info
        return info["override"], info["classes"]
    if variant != "default":
        raise SystemExit(f"{root}/traces/{name} has no variant '{variant}'")
    return {}, sorted(set(load.Scene(name, root).class_names) - {""})


def as_frame(index: int, golden: load.Frame) -> Frame:
    """A golden frame as a source would give it."""
    detections = Detections.create(golden.masks, golden.classes)
    return Frame(
        index, index, float(index), str(index), detections=detections, features=golden.features
    )


def step_ours(tracker: Tracker, frame: Frame) -> dict[str, float]:
    """Steps one frame; milliseconds per stage, descriptors timed once more on their own."""
    start = time.perf_counter()
    prepared = tracker.prepare(frame)
    masked = time.perf_counter()
    tracker.advance(prepared)
    done = time.perf_counter()
    step_ms = 1e3 * (done - masked)
    describe_ms = time_description(tracker, frame, prepared.masks)
    return {
        "masks": 1e3 * (masked - start),
        "describe": describe_ms,
        "decide and remember": max(0.0, step_ms - describe_ms),
        WHOLE_FRAME: 1e3 * (done - start),
    }


def time_description(tracker: Tracker, frame: Frame, masks: Any) -> float:
    """Milliseconds of the first part of the step, compiled on its own."""
    static = tracker.static
    padded = pad_masks(masks, static.num_detections)
    feats = FrameFeats(frame.features, np.array(frame.size, np.int32))  # pyright: ignore
    thresholds = tracker.config.thresholds.as_arrays(static.scalar)
    start = time.perf_counter()
    jax.block_until_ready(_describe(feats, padded, static, thresholds))
    return 1e3 * (time.perf_counter() - start)


def measure(root: Path, name: str, variant: str) -> list[dict[str, Any]]:
    """One row per stage and one for the whole frame."""
    overrides, classes = read_settings(root, name, variant)
    tracker = make_tracker(root, name, variant)
    peer = Peer(os.environ.get("REMIND_ORIGINAL"), root, name, overrides, classes)
    ours: dict[str, list[float]] = {stage: [] for stage in (WHOLE_FRAME, *STAGES)}
    theirs: list[float] = []
    try:
        for index, golden in enumerate(load.load_inputs(name, root)):
            for stage, milliseconds in step_ours(tracker, as_frame(index, golden)).items():
                ours[stage].append(milliseconds)
            tracker._memory.ahead.finish()  # what is compiled ahead is no part of a step
            answer = peer.step_ms()
            theirs += [] if answer is None else [answer]
    finally:
        peer.close()
    prefix = f"{name}/{variant}"
    rows = [make_row(f"{prefix}: {WHOLE_FRAME}", ours[WHOLE_FRAME], theirs)]
    return rows + [make_row(f"{prefix}: {stage}", ours[stage], None) for stage in STAGES]


def profile(root: Path, name: str, variant: str, num_frames: int) -> Iterator[dict[str, Any]]:
    """Kernels per frame of the last frames, by kind, module, line and kernel; the longest ones."""
    tracker = make_tracker(root, name, variant)
    frames = [as_frame(index, golden) for index, golden in enumerate(load.load_inputs(name, root))]
    for frame in frames[:-num_frames]:
        tracker.update(frame)
    with record() as recording:
        for frame in frames[-num_frames:]:
            tracker.update(frame)
    programs = tracker._memory.frame_step.programs()
    texts = [cast("Any", program.run).as_text() for program in programs]
    yield from make_rows(recording.kernels, texts, num_frames, most=20)


def make_tracker(root: Path, name: str, variant: str) -> Tracker:
    """Our tracker with the settings of a variant and as many slots as the sequence needs."""
    overrides, _ = read_settings(root, name, variant)
    config = Config.from_reference(overrides)
    most = int((load.Scene(name, root).order != load.NO_LABEL).sum(axis=1).max())
    return Tracker(config.updated({"static": {"num_detections": most}}))


def make_row(name: str, ours: list[float], theirs: list[float] | None) -> dict[str, Any]:
    """Medians and 95th percentiles without the first frame, which compiles."""
    ours_ms = statistics.median(ours[1:])
    peer_ms = statistics.median(theirs[1:]) if theirs else None
    peer = None if theirs is None else "original" if theirs else "original: absent"
    return {
        "name": name,
        "ours_ms": ours_ms,
        "ours_p95_ms": float(np.percentile(ours[1:], 95)),
        "first_s": ours[0] / 1e3,
        "peer": peer,
        "peer_ms": peer_ms,
        "peer_p95_ms": float(np.percentile(theirs[1:], 95)) if theirs else None,
        "ratio": peer_ms / ours_ms if peer_ms else None,
    }


def print_rows(rows: list[dict[str, Any]]) -> None:
    """Prints the table."""

    def show(value: float | None) -> str:
        return "" if value is None else f"{value:.2f}"

    print(f"{'':42}{'ms':>8}{'p95':>8}{'first s':>9}{'peer ms':>9}{'p95':>8}{'ratio':>7}  peer")
    for row in rows:
        print(
            f"{row['name']:42}{show(row['ours_ms']):>8}{show(row['ours_p95_ms']):>8}"
            f"{show(row['first_s']):>9}{show(row['peer_ms']):>9}{show(row['peer_p95_ms']):>8}"
            f"{show(row['ratio']):>7}  {row['peer'] or ''}"
        )


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--sequence", type=Path, default=DEFAULT_SEQUENCE, metavar="FOLDER/NAME")
    parser.add_argument("--variant", default="default")
    parser.add_argument("--json", type=Path, metavar="OUT")
    parser.add_argument("--profile", type=int, default=0, metavar="FRAMES")
    options = parser.parse_args()
    if options.profile:
        sequence = options.sequence
        found = profile(sequence.parent, sequence.name, options.variant, options.profile)
        show_rows(found, options.json)
        return
    rows = measure(options.sequence.parent, options.sequence.name, options.variant)
    print_rows(rows)
    if options.json is not None:
        options.json.write_text(json.dumps(rows, indent=1) + "\n")


if __name__ == "__main__":
    main()
