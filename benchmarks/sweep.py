"""Settings x frames per second of a sweep, beside the warm single-run program in the same run.

    python benchmarks/sweep.py [--sequence FOLDER/NAME] [--settings 256] [--batch N] [--json OUT]

Features are given. Both sides start from described detections and end with identities; the single
runs go through the same frames, one setting after the other, of which `--singles` are timed. The
first call of each program compiles and is reported apart. A sweep uses all cores and a single run
one, so times are given by the clock and by the processor. Where REMIND_ORIGINAL names the work
tree of the original, it steps through the sequence meanwhile, a few frames after every batch.
"""

from __future__ import annotations

import argparse
import dataclasses
import functools
import json
import os
import sys
import time
from collections.abc import Callable
from pathlib import Path

import jax
import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from benchmarks.step import DEFAULT_SEQUENCE, Peer, as_frame, read_settings
from remind_jax.backbone.registry import get_backbone
from remind_jax.compiled.compiler_options import compiler_options
from remind_jax.compiled.frame_step import settle_types
from remind_jax.config import load_config
from remind_jax.remind.state import init
from remind_jax.remind.tracker import decide
from remind_jax.sources import open_source
from remind_jax.sweeps.batches import plan_batch, run_batch
from remind_jax.sweeps.scene_arrays import describe_scene, load_scene
from remind_jax.sweeps.settings import complete, draw, stack
from tests.golden import load

SPACE = {
    "matching.match": (0.5, 0.8),
    "appearance.duplicate": (0.6, 0.95),
    "diagnosis.close": (0.01, 0.1),
    "diagnosis.strong_gap": (0.02, 0.2),
}
GIB = 1 << 30


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--sequence", type=Path, default=DEFAULT_SEQUENCE, metavar="FOLDER/NAME")
    parser.add_argument("--settings", type=int, default=256)
    parser.add_argument("--singles", type=int, default=4)
    parser.add_argument("--batch", type=int)
    parser.add_argument("--memory-gib", type=float, default=2.0)
    parser.add_argument("--json", type=Path, metavar="OUT")
    options = parser.parse_args()

    config = load_config("published")
    root, name = options.sequence.parent, options.sequence.name
    frames = [as_frame(i, golden) for i, golden in enumerate(load.load_inputs(name, root))]
    frames = [  # who is who does not matter here
        dataclasses.replace(
            f,
            detections=dataclasses.replace(
                f.detections, instance_ids=np.arange(len(f.detections)) + 1
            ),
        )
        for f in frames
    ]
    scene = load_scene(open_source(frames), config, get_backbone("patch-statistics"))
    static = dataclasses.replace(
        config.static,
        feature_dim=scene.feats[0].patches.shape[-1],
        num_detections=scene.most_detections,
    )
    described = describe_scene(scene, static, config)
    settings = complete(draw(SPACE, options.settings), config)

    start = time.process_time()
    batch, num_bytes, compile_s = options.batch, 0, 0.0
    if batch is None:
        budget = int(options.memory_gib * GIB)
        batch, num_bytes = plan_batch(described, config, static, len(settings), budget)
    compile_s = time.process_time() - start
    _, static = run_batch(described, config, settings[:batch], static)
    first_s = time.process_time() - start

    step = jax.jit(
        lambda state, frame, t: settle_types(decide(state, frame, static=static, thresholds=t)[0]),
        donate_argnums=0,
        compiler_options=compiler_options(),
    )
    single_frames = [jax.tree.map(lambda x, i=i: x[i], described) for i in range(len(frames))]

    def run_single(index: int) -> None:
        stacked = stack(config.thresholds, settings[index : index + 1], static.scalar)
        thresholds = jax.device_put(jax.tree.map(lambda leaf: leaf[0], stacked))
        state = settle_types(init(static))
        for frame in single_frames:
            state = step(state, frame, thresholds)
            jax.device_get(state.decisions.object_id)

    run_single(0)
    overrides, classes = read_settings(root, name, "default")
    peer = Peer(os.environ.get("REMIND_ORIGINAL"), root, name, overrides, classes)
    peer_ms = [peer.step_ms()]
    run = functools.partial(run_batch, described, config)
    singles, batches = [], []
    groups = [settings[first : first + batch] for first in range(0, len(settings), batch)]
    groups = [group for group in groups if len(group) == batch]
    share = (len(frames) - 1) // len(groups)
    for turn, group in enumerate(groups):  # alternating, on the same busy machine
        batches.append(timed(functools.partial(run, group, static)))
        if turn < options.singles:
            singles.append(timed(functools.partial(run_single, turn)))
        peer_ms += [peer.step_ms() for _ in range(share)]
    peer.close()
    rate, cpu_rate = batch * len(frames) / np.median(batches, axis=0)
    single_rate, single_cpu_rate = len(frames) / np.median(singles, axis=0)
    theirs = [ms for ms in peer_ms[1:] if ms is not None]
    row = {
        "sequence": name,
        "settings": options.settings,
        "batch": batch,
        "program_mib": num_bytes / 2**20,
        "compile_cpu_s": compile_s,  # 0 if the batch was given
        "first_cpu_s": first_s,
        "settings_x_frames_per_s": float(rate),
        "settings_x_frames_per_cpu_s": float(cpu_rate),
        "single_frames_per_s": float(single_rate),
        "single_frames_per_cpu_s": float(single_cpu_rate),
        "ratio": float(rate / single_rate),
        "cpu_ratio": float(cpu_rate / single_cpu_rate),
        "original_frames_per_s": 1e3 / float(np.median(theirs)) if theirs else None,
        "ratio_to_original": float(rate * np.median(theirs)) / 1e3 if theirs else None,
        "device": jax.devices()[0].device_kind,
    }
    for key, value in row.items():
        print(f"{key:26}{value:.2f}" if isinstance(value, float) else f"{key:26}{value}")
    if options.json is not None:
        options.json.write_text(json.dumps(row, indent=1) + "\n")


def timed(work: Callable[[], object]) -> tuple[float, float]:
    """Seconds of the clock and of the processor that it takes."""
    start, cpu = time.perf_counter(), time.process_time()
    work()
    return time.perf_counter() - start, time.process_time() - cpu


if __name__ == "__main__":
    main()
