"""Settings x frames per second of a sweep, beside the warm single-run program in the same run.

    python benchmarks/sweep.py [--sequence FOLDER/NAME] [--settings 256] [--batch N] [--json OUT]

Features are given. Both sides start from described detections and end with identities; the single
runs go through the same frames, one setting after the other, of which `--singles` are timed. The
first call of each program compiles and is reported apart.
"""

from __future__ import annotations

import argparse
import dataclasses
import functools
import json
import sys
import time
from pathlib import Path

import jax
import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from benchmarks.step import DEFAULT_SEQUENCE, as_frame
from remind_jax.backbone.registry import get_backbone
from remind_jax.compiled.frame_step import ONE_FRAME_OPTIONS, settle_types
from remind_jax.config import load_config
from remind_jax.remind.state import init
from remind_jax.remind.tracker import step_described
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

    start = time.perf_counter()
    batch, num_bytes, compile_s = options.batch, 0, 0.0
    if batch is None:
        budget = int(options.memory_gib * GIB)
        batch, num_bytes = plan_batch(described, config, static, len(settings), budget)
    compile_s = time.perf_counter() - start
    _, static = run_batch(described, config, settings[:batch], static)
    first_s = time.perf_counter() - start

    step = jax.jit(
        lambda state, frame, t: settle_types(
            step_described(state, frame.descriptors, frame.masks, static=static, thresholds=t)
        ),
        donate_argnums=0,
        compiler_options=ONE_FRAME_OPTIONS.get(jax.default_backend()),
    )
    single_frames = [jax.tree.map(lambda x, i=i: x[i], described) for i in range(len(frames))]

    def run_single(index: int) -> float:
        stacked = stack(config.thresholds, settings[index : index + 1], static.scalar)
        thresholds = jax.device_put(jax.tree.map(lambda leaf: leaf[0], stacked))
        start, state = time.perf_counter(), settle_types(init(static))
        for frame in single_frames:
            state = step(state, frame, thresholds)
            jax.device_get(state.decisions.object_id)
        return time.perf_counter() - start

    run_single(0)
    run = functools.partial(run_batch, described, config)
    single_s, batch_s = [], []
    groups = [settings[first : first + batch] for first in range(0, len(settings), batch)]
    for turn, group in enumerate(g for g in groups if len(g) == batch):
        start = time.perf_counter()
        run(group, static)
        batch_s.append(time.perf_counter() - start)
        if turn < options.singles:  # alternating, on the same busy machine
            single_s.append(run_single(turn))
    rate = batch * len(frames) / float(np.median(batch_s))
    single_rate = len(frames) / float(np.median(single_s))
    row = {
        "sequence": name,
        "settings": options.settings,
        "batch": batch,
        "program_mib": num_bytes / 2**20,
        "compile_s": compile_s,  # 0 if the batch was given
        "first_s": first_s,
        "settings_x_frames_per_s": rate,
        "single_frames_per_s": single_rate,
        "ratio": rate / single_rate,
        "device": jax.devices()[0].device_kind,
    }
    for key, value in row.items():
        print(f"{key:26}{value:.2f}" if isinstance(value, float) else f"{key:26}{value}")
    if options.json is not None:
        options.json.write_text(json.dumps(row, indent=1) + "\n")


if __name__ == "__main__":
    main()
