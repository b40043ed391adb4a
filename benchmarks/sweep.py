"""Settings x frames per second of a sweep, beside the warm single-run program in the same run.

    python benchmarks/sweep.py [--config published] [--settings 256] [--batch N] [--json OUT]
    python benchmarks/sweep.py --config default --source FOLDER [--settings 64]
    python benchmarks/sweep.py --scenes 24 [--config default] [--settings 16]

Both sides start from described detections and end with identities; the single runs go through the
same frames with the capacities of the configuration, one setting after the other, of which
`--singles` are timed. What compiles is reported apart. A sweep uses all cores and a single run one,
so times are given by the clock and by the processor. Rows that do not equal those of their single
run are counted. The published configuration runs on a golden sequence whose features are given
(`--sequence`); where REMIND_ORIGINAL names the work tree of the original, it steps through it
meanwhile, a few frames after every batch. `--scenes` times a whole sweep over so many rendered
scenes of 60 frames, beside a sweep per scene.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import os
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import jax
import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from benchmarks.step import DEFAULT_SEQUENCE, Peer, as_frame, read_settings
from remind_jax.backbone.registry import get_backbone
from remind_jax.compiled.compiler_options import compiler_options
from remind_jax.compiled.frame_step import settle_types
from remind_jax.config import Config, load_config
from remind_jax.method import get_method
from remind_jax.sources import open_source
from remind_jax.sweeps.batches import plan_batch, run_batch
from remind_jax.sweeps.bench import SceneBench
from remind_jax.sweeps.scene_arrays import SceneFrames, describe_scene, load_scene
from remind_jax.sweeps.sensitivity import PLUS_SPACE
from remind_jax.sweeps.settings import Setting, complete, draw, stack
from remind_jax.synthetic import LookalikeGroup, SceneOptions, make_scene, render
from tests.golden import load

SPACES = {
    "published": {
        "matching.match": (0.5, 0.8),
        "appearance.duplicate": (0.6, 0.95),
        "diagnosis.close": (0.01, 0.1),
        "diagnosis.strong_gap": (0.02, 0.2),
    },
    "default": PLUS_SPACE,
}
GIB = 1 << 30


def main() -> None:
    """Parses the command line, measures and prints."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--config", choices=tuple(SPACES), default="published")
    parser.add_argument("--sequence", type=Path, default=DEFAULT_SEQUENCE, metavar="FOLDER/NAME")
    parser.add_argument("--source", type=Path, metavar="FOLDER")
    parser.add_argument("--scenes", type=int, default=0)
    parser.add_argument("--settings", type=int, default=256)
    parser.add_argument("--singles", type=int, default=4)
    parser.add_argument("--batch", type=int)
    parser.add_argument("--memory-gib", type=float, default=2.0)
    parser.add_argument("--json", type=Path, metavar="OUT")
    options = parser.parse_args()
    if options.config == "default" and not (options.source or options.scenes):
        parser.error("the default has no golden features; give --source or --scenes")
    row = measure_scenes(options) if options.scenes else measure_settings(options)
    for key, value in row.items():
        print(f"{key:30}{value:.2f}" if isinstance(value, float) else f"{key:30}{value}")
    if options.json is not None:
        options.json.write_text(json.dumps(row, indent=1) + "\n")


def measure_settings(options: argparse.Namespace) -> dict[str, Any]:
    """Batches of settings on one scene, beside single runs and the original."""
    scene = read_scene(options)
    config = scene.config
    dim = scene.feats[0].patches.shape[-1]
    static = dataclasses.replace(config.static, feature_dim=dim, **scene.capacities)
    described = describe_scene(scene, static, config)
    settings = complete(draw(SPACES[options.config], options.settings), config)

    start = time.process_time()
    batch, num_bytes = options.batch, 0
    if batch is None:
        budget = int(options.memory_gib * GIB)
        batch, num_bytes = plan_batch(described, config, static, len(settings), budget)
    compile_s = time.process_time() - start
    _, static = run_batch(described, config, settings[:batch], static, batch)
    first_s = time.process_time() - start

    run_single = single_runs(scene, settings)
    run_single(0)
    peer, peer_ms = start_peer(options), []
    peer_ms.append(peer.step_ms())
    singles, batches, unequal = [], [], 0
    groups = [range(first, first + batch) for first in range(0, len(settings), batch)]
    groups = [group for group in groups if group[-1] < len(settings)]
    share = (scene.num_frames - 1) // len(groups)
    for turn, group in enumerate(groups):  # alternating, on the same busy machine
        chosen = [settings[i] for i in group]
        (answers, _), spent = timed(
            lambda chosen=chosen: run_batch(described, config, chosen, static, batch)
        )
        batches.append(spent)
        if turn < options.singles:
            alone, spent = timed(lambda index=group[0]: run_single(index))
            singles.append(spent)
            num = min(alone.shape[-1], answers.object_id.shape[-1])
            unequal += not np.array_equal(alone[:, :num], answers.object_id[:, 0, :num])
        peer_ms += [peer.step_ms() for _ in range(share)]
    peer.close()
    rate, cpu_rate = batch * scene.num_frames / np.median(batches, axis=0)
    single_rate, single_cpu_rate = scene.num_frames / np.median(singles, axis=0)
    theirs = [ms for ms in peer_ms[1:] if ms is not None]
    return {
        "scene": scene.name,
        "settings": options.settings,
        "batch": batch,
        "object_slots": static.num_objects,
        "program_mib": num_bytes / 2**20,
        "compile_cpu_s": compile_s,  # 0 if the batch was given
        "first_cpu_s": first_s,
        "settings_x_frames_per_s": float(rate),
        "settings_x_frames_per_cpu_s": float(cpu_rate),
        "single_frames_per_s": float(single_rate),
        "single_frames_per_cpu_s": float(single_cpu_rate),
        "ratio": float(rate / single_rate),
        "cpu_ratio": float(cpu_rate / single_cpu_rate),
        "rows_unequal": f"{unequal} of {len(singles)}",
        "original_frames_per_s": 1e3 / float(np.median(theirs)) if theirs else None,
        "ratio_to_original": float(rate * np.median(theirs)) / 1e3 if theirs else None,
        "device": jax.devices()[0].device_kind,
    }


def measure_scenes(options: argparse.Namespace) -> dict[str, Any]:
    """One sweep over many scenes, beside a sweep for each of them, in turn with it."""
    scenes = [render_tour(seed) for seed in range(1, options.scenes + 1)]
    settings = draw(SPACES[options.config], options.settings)

    def sweep_over(some: Sequence[Any]) -> None:
        SceneBench(some, config=options.config, memory_gib=options.memory_gib).run(settings)

    sweep_over(scenes[:1])
    _, together = timed(lambda: sweep_over(scenes))
    _, apart = timed(lambda: [sweep_over([scene]) for scene in scenes])
    frames = sum(len(scene) for scene in scenes) * len(settings)
    return {
        "scenes": len(scenes),
        "settings": len(settings),
        "settings_x_frames_per_s": frames / together[0],
        "settings_x_frames_per_cpu_s": frames / together[1],
        "ratio": apart[0] / together[0],
        "cpu_ratio": apart[1] / together[1],
        "device": jax.devices()[0].device_kind,
    }


def read_scene(options: argparse.Namespace) -> SceneFrames:
    """The scene, with the features that the configuration has."""
    config, backbone = load_config(options.config), get_backbone("patch-statistics")
    if options.source is not None:
        return load_scene(open_source(options.source), config, backbone)
    root, name = options.sequence.parent, options.sequence.name
    frames = [as_frame(i, golden) for i, golden in enumerate(load.load_inputs(name, root))]
    # Who is who does not matter here.
    detections = [
        dataclasses.replace(f.detections, instance_ids=np.arange(len(f.detections)) + 1)
        for f in frames
    ]
    frames = [
        dataclasses.replace(frame, detections=one)
        for frame, one in zip(frames, detections, strict=True)
    ]
    return load_scene(open_source(frames), config, backbone)


def single_runs(scene: SceneFrames, settings: Sequence[Setting]) -> Callable[[int], np.ndarray]:
    """Takes the scene through the single program of a setting, frame by frame; ids `[T, N]`."""
    config: Config = scene.config
    method = get_method(config.tracker)
    static = config.static.grow(num_detections=scene.most_detections)
    static = dataclasses.replace(static, feature_dim=scene.feats[0].patches.shape[-1])
    described = describe_scene(scene, static, config)
    step = jax.jit(
        lambda state, frame, t: settle_types(
            method.decide(state, frame, static=static, thresholds=t)[0]
        ),
        donate_argnums=0,
        compiler_options=compiler_options(),
    )
    frames = [jax.tree.map(lambda x, i=i: x[i], described) for i in range(scene.num_frames)]

    def run(index: int) -> np.ndarray:
        stacked = stack(config.thresholds, settings[index : index + 1], static.scalar)
        thresholds = jax.device_put(jax.tree.map(lambda leaf: leaf[0], stacked))
        state, found = settle_types(method.init(static)), []
        for frame in frames:
            state = step(state, frame, thresholds)
            found.append(jax.device_get(state.decisions.object_id))
        return np.stack(found)

    return run


def start_peer(options: argparse.Namespace) -> Peer:
    """The original on the same sequence, if there is one."""
    if options.source is not None:
        return Peer(None, options.source, "", {}, [])
    root, name = options.sequence.parent, options.sequence.name
    overrides, classes = read_settings(root, name, "default")
    return Peer(os.environ.get("REMIND_ORIGINAL"), root, name, overrides, classes)


def render_tour(seed: int) -> list[Any]:
    """A short tour with look-alikes."""
    options = SceneOptions(
        name=f"tour{seed}", seed=seed, width=160, height=128, min_mask_px=25, frames=60,
        objects_per_room=6 + seed % 5, absence_frames=12, light_drop=0.3,
        lookalikes=(LookalikeGroup("mug", 3), LookalikeGroup("box", 2, "tint")),
    )  # fmt: skip
    return list(render(make_scene(options)))


def timed(work: Callable[[], Any]) -> tuple[Any, tuple[float, float]]:
    """What it gives, and the seconds of the clock and of the processor that it takes."""
    start, cpu = time.perf_counter(), time.process_time()
    result = work()
    return result, (time.perf_counter() - start, time.process_time() - cpu)


if __name__ == "__main__":
    main()
