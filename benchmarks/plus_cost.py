"""What REMIND plus takes: time of a step, size of the memory, and both over thousands of frames.

    python benchmarks/plus_cost.py step         time and memory at several sizes
    python benchmarks/plus_cost.py endurance    3,000 frames along 200 made-up things

`--json FILE` writes rows.
"""

from __future__ import annotations

import argparse
import dataclasses
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import jax
import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from benchmarks.plus_recording import Recording, judge
from benchmarks.rows import show_rows
from remind_jax.compiled.compiler_options import compiler_options
from remind_jax.compiled.packing import Bundle
from remind_jax.frame import NO_INSTANCE
from remind_jax.plus.observation import Motion, Sightings
from remind_jax.plus.state import init
from remind_jax.plus.thresholds import PlusThresholds
from remind_jax.plus.tracker import advance
from remind_jax.static import Static


def cost() -> Iterator[dict[str, Any]]:
    """Milliseconds of a step and megabytes of the memory for some capacities."""
    for detections, objects, dim in ((12, 60, 223), (12, 60, 384), (30, 200, 384), (30, 500, 384)):
        static = Static(
            num_detections=detections, num_objects=objects + 2 * detections, feature_dim=dim
        )
        frames = _made_up_frames(detections, objects, dim)
        memory = Bundle.of(init(static))
        size = sum(leaf.nbytes for leaf in jax.tree.leaves(memory)) / 2**20
        step = _compile_as_run(static)
        spent = []
        for frame in frames:
            start = time.perf_counter()
            memory = jax.block_until_ready(step(memory, *frame))
            spent.append(1000 * (time.perf_counter() - start))
            assert not int(memory.read().overflow.objects), "more objects than there is room for"
        known = int(np.sum(memory.read().objects.exists))
        settled = spent[len(spent) // 2 :]
        yield {
            "name": f"{detections} detections, {known} objects, D {dim}",
            "median_ms": float(np.median(settled)),
            "p95_ms": float(np.percentile(settled, 95)),
            "least_ms": float(np.min(settled)),
            "compile_s": spent[0] / 1000,
            "memory_MiB": size,
        }


def endure(num_frames: int = 3000, num_things: int = 200) -> Iterator[dict[str, Any]]:
    """There and back along a corridor of things: identities, time and memory as it goes on."""
    recording = _corridor(num_frames, num_things)
    num, dim = recording.sightings.look.shape[1:]
    static = Static(num_detections=num, num_objects=num_things + 56, feature_dim=dim)
    memory = Bundle.of(init(static))
    size = sum(leaf.nbytes for leaf in jax.tree.leaves(memory)) / 2**20
    step = _compile_as_run(static)
    ids, spent = np.full(recording.truth.shape, -1), np.zeros(num_frames)
    inputs = (recording.sightings, recording.motion, recording.present)
    for row in range(num_frames):
        frame = jax.tree.map(lambda leaf, row=row: leaf[row], inputs)
        start = time.perf_counter()
        memory = jax.block_until_ready(step(memory, *frame))
        spent[row] = 1000 * (time.perf_counter() - start)
        state = memory.read()
        assert not int(state.overflow.objects), "more objects than there is room for"
        ids[row] = state.answers.answer_id
        if (row + 1) % (num_frames // 3) == 0:
            so_far = dataclasses.replace(recording, truth=recording.truth[: row + 1])
            scores = judge(so_far, ids[: row + 1])
            recent = spent[row + 1 - num_frames // 3 : row + 1]
            yield {
                "name": f"{row + 1} frames",
                **{key: scores[key] for key in ("IDF1", "IDSW", "ids", "objects", "repeated")},
                "in_memory": float(np.sum(state.objects.exists)),
                "median_ms": float(np.median(recent)),
                "memory_MiB": size,
            }


def _compile_as_run(static: Static) -> Any:
    """The step as runs compile it."""

    def step(memory: Bundle, *frame: Any) -> Bundle:
        state, _ = advance(memory.unpack(), *frame, static=static, thresholds=PlusThresholds())
        return Bundle.of(state)

    return jax.jit(step, donate_argnums=0, compiler_options=compiler_options())


def _corridor(num_frames: int, num_things: int, dim: int = 64, most: int = 14) -> Recording:
    """A camera that goes there and back along things at random heights, six times."""
    rng = np.random.default_rng(0)
    along = 0.5 * np.arange(num_things)
    place = np.stack([along, rng.uniform(0.8, 4, num_things)], axis=1).astype(np.float32)
    look = rng.normal(size=(num_things, dim)).astype(np.float32)
    size = rng.uniform(0.3, 0.5, num_things).astype(np.float32)
    far = along[-1] - 5
    camera = far * (0.5 - 0.5 * np.cos(np.linspace(0, 6 * np.pi, num_frames))) - 0.5
    shape = (num_frames, most)
    truth = np.full(shape, NO_INSTANCE)
    center = np.zeros((*shape, 2), np.float32)
    for row, left in enumerate(camera):
        seen = np.flatnonzero((along > left + 0.3) & (along < left + 6.1))[:most]
        truth[row, : len(seen)] = seen
        center[row, : len(seen)] = place[seen] - np.float32([left, 0])
    present = truth != NO_INSTANCE
    which = np.where(present, truth, 0)
    center += rng.normal(0, 0.02, center.shape).astype(np.float32)
    half = size[which][..., None] / 2
    matrix = np.tile(np.eye(2, 3, dtype=np.float32), (num_frames, 1, 1))
    matrix[1:, 0, 2] = -np.diff(camera)
    sightings = Sightings(
        look=look[which] + rng.normal(0, 0.3, (*shape, dim)).astype(np.float32),
        is_background=np.zeros((num_frames, dim), bool),
        light_changes=np.zeros((num_frames, 0, dim), np.float32),
        ring=np.ones((*shape, dim), np.float32),
        has_ring=present,
        box=np.concatenate([center - half, center + half], axis=-1),
        center=center,
        size=size[which],
        class_id=np.zeros(shape, np.int32),
        touches=np.zeros(shape, bool),
        valid=present,
        frame_center=np.tile(np.float32([3.2, 2.4]), (num_frames, 1)),
        num_bad_patches=np.zeros(num_frames, np.int32),
    )
    score = np.full(num_frames, 0.9, np.float32)
    motion = Motion(
        matrix,
        score,
        np.tile(np.int32([480, 640]), (num_frames, 1)),
        np.ones(num_frames, np.float32),
    )
    return Recording("corridor", sightings, motion, truth, present)


def _made_up_frames(detections: int, objects: int, dim: int) -> list[Any]:
    """Groups of objects side by side, each in view for ten frames, all of them twice."""
    rng = np.random.default_rng(0)
    look = rng.normal(size=(objects, dim)).astype(np.float32)
    place = rng.uniform(0.5, 5.5, (objects, 2)).astype(np.float32)
    groups = [
        np.arange(first, first + detections) % objects for first in range(0, objects, detections)
    ]
    half, here = np.float32(0.2), np.ones(detections, bool)
    frames, before = [], 0
    for number in 2 * [number for number in range(len(groups)) for _ in range(10)]:
        index = groups[number]
        matrix = np.eye(2, 3, dtype=np.float32)
        matrix[0, 2] = 640 * (before - number)
        motion = Motion(matrix, np.float32(0.9), np.array([480, 640], np.int32), np.float32(1))
        before = number
        center = place[index]
        frames.append(
            (
                Sightings(
                    look=look[index] + 0.1 * rng.normal(size=(detections, dim)).astype(np.float32),
                    is_background=np.zeros(dim, bool),
                    light_changes=np.zeros((0, dim), np.float32),
                    ring=look[index],
                    has_ring=here,
                    box=np.concatenate([center - half, center + half], axis=1),
                    center=center,
                    size=np.full(detections, 0.4, np.float32),
                    class_id=np.zeros(detections, np.int32),
                    touches=~here,
                    valid=here,
                    frame_center=np.array([3.2, 2.4], np.float32),
                    num_bad_patches=np.int32(0),
                ),
                motion,
                here,
            )
        )
    return frames


def main() -> None:
    """Prints a table row by row."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("what", choices=("step", "endurance"))
    parser.add_argument("--json", type=Path)
    given = parser.parse_args()
    show_rows(cost() if given.what == "step" else endure(), given.json)


if __name__ == "__main__":
    main()
