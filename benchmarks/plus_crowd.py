"""What REMIND plus takes in a crowd: hundreds of detections in a frame, thousands of objects.

    python benchmarks/plus_crowd.py
    python benchmarks/plus_crowd.py --detections 500 --objects 60 2000

CPU milliseconds of a frame in which all detections are open, and of one where all are decided that
can be, both after the first frame; memory of the tracker, of a step for the time being, and the
peak of a process of its own, compilation included. `--json FILE` writes rows.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import resource
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from benchmarks.rows import show_rows
from remind_jax.compiled.compiler_options import compiler_options
from remind_jax.plus.observation import Motion, Sightings
from remind_jax.plus.state import PlusState, init
from remind_jax.plus.thresholds import PlusThresholds
from remind_jax.plus.tracker import advance
from remind_jax.static import Static

DIM = 223
FRAMES = 6
MIB = 2**20


def measure(detections: int, objects: int) -> dict[str, Any]:
    """One size, in this process."""
    static = Static(feature_dim=DIM).grow(
        num_detections=detections, num_objects=objects + 2 * detections
    )
    rng = np.random.default_rng(0)
    num = max(detections, objects)
    look = rng.normal(size=(num, DIM)).astype(np.float32)
    place = rng.uniform([0.3, 0.3], [6.1, 4.5], (num, 2)).astype(np.float32)
    size = rng.uniform(0.2, 0.4, num).astype(np.float32)
    state = jax.device_put(_remember(static, look[:objects], place[:objects], size[:objects]))

    def step(state: PlusState, frame: Any, thresholds: Any) -> PlusState:
        return advance(state, *frame, static=static, thresholds=thresholds)[0]

    thresholds = jax.tree.map(jnp.asarray, PlusThresholds())
    frames = [
        _frame(static.num_detections, look[:detections], place[:detections], size[:detections], rng)
        for _ in range(FRAMES)
    ]
    jitted = jax.jit(step, donate_argnums=0, compiler_options=compiler_options())
    compiled = jitted.lower(state, frames[0], thresholds).compile()
    memory = compiled.memory_analysis()
    spent = []
    for frame in frames:
        start = time.process_time()
        state = jax.block_until_ready(compiled(state, frame, thresholds))
        spent.append(1000 * (time.process_time() - start))
        assert not int(state.overflow.objects), "more objects than there is room for"
    known = min(detections, objects)
    return {
        "name": f"{detections} detections, {objects} objects",
        "open_ms": spent[1],
        "settled_ms": float(np.median(spent[3:])),
        "memory_MiB": sum(leaf.nbytes for leaf in jax.tree.leaves(state)) / MIB,
        "temporary_MiB": 0.0 if memory is None else memory.temp_size_in_bytes / MIB,
        "peak_MiB": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,
        "right": float(np.mean(np.asarray(state.answers.answer_id)[:known] == np.arange(known))),
    }


def _remember(static: Static, look: Any, place: Any, size: Any) -> PlusState:
    """A memory of objects that were often seen side by side."""
    state = jax.tree.map(np.array, init(static))
    num, objects, pairs = len(look), state.objects, state.pairs
    objects.id[:num] = np.arange(num)
    objects.class_id[:num], objects.seen[:num], objects.last[:num] = 0, 20, -5
    objects.size[:num], objects.position[:num] = size, place
    objects.bank[:num, 0], objects.bank_count[:num, 0] = look, 3
    white = look[:, : objects.white_bank.shape[2]]
    objects.white_bank[:num, 0] = white / np.linalg.norm(white, axis=1, keepdims=True)
    objects.ring[:num], objects.ring_count[:num] = look[:, ::-1], 3
    both = np.s_[:num, :num]
    scale = np.sqrt(size[:, None] * size[None])
    pairs.covariance[both] = 0.01 + 0.02 * np.eye(num)
    pairs.covisible[both], pairs.spread[both] = 5, 0.2
    pairs.relation[both] = (place[None] - place[:, None]) / scale[..., None]
    pairs.log_ratio[both] = np.log(size[:, None] / size[None])
    return dataclasses.replace(state, next_id=np.int32(num), frame=np.int32(100))


def _frame(room: int, look: Any, place: Any, size: Any, rng: np.random.Generator) -> Any:
    num = len(look)

    def padded(values: np.ndarray) -> np.ndarray:
        return np.concatenate([values, np.ones((room - num, *values.shape[1:]), values.dtype)])

    here = np.arange(room) < num
    center = place + rng.normal(0, 0.005, place.shape).astype(np.float32)
    half = size[:, None] / 2
    noise = 0.1 * rng.normal(size=look.shape).astype(np.float32)
    sightings = Sightings(
        look=padded(look + noise),
        is_background=np.zeros(DIM, bool),
        light_changes=np.zeros((0, DIM), np.float32),
        ring=padded(look[:, ::-1].copy()),
        has_ring=here,
        box=padded(np.concatenate([center - half, center + half], axis=1)),
        center=padded(center),
        size=padded(size),
        class_id=np.zeros(room, np.int32),
        touches=np.zeros(room, bool),
        valid=here,
        frame_center=np.array([3.2, 2.4], np.float32),
        num_bad_patches=np.int32(0),
    )
    still = Motion(
        np.eye(2, 3, dtype=np.float32),
        np.float32(0.9),
        np.array([480, 640], np.int32),
        np.float32(1),
    )
    return sightings, still, here


def measure_all(detections: list[int], objects: list[int]) -> Iterator[dict[str, Any]]:
    """Every size in a process of its own, whose peak of memory is its own."""
    for most in objects:
        for num in detections:
            command = [sys.executable, __file__, "--one", str(num), str(most)]
            said = subprocess.run(command, check=True, capture_output=True, text=True).stdout
            yield json.loads(said)


def main() -> None:
    """Parses the command line, measures and prints."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--detections", type=int, nargs="+", default=[12, 125, 250, 500])
    parser.add_argument("--objects", type=int, nargs="+", default=[60, 2000])
    parser.add_argument("--one", type=int, nargs=2, help=argparse.SUPPRESS)
    parser.add_argument("--json", type=Path)
    given = parser.parse_args()
    if given.one:
        print(json.dumps(measure(*given.one)))
    else:
        show_rows(measure_all(given.detections, given.objects), given.json)


if __name__ == "__main__":
    main()
