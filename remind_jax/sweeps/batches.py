"""Runs one scene under many settings, as many at once as memory allows.

On a CPU a batch is shared between its cores: each takes its lane of settings through the frames in
a thread of its own. Kernels of a step are too small to be shared one by one.
"""

from __future__ import annotations

import dataclasses
import os
import threading
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import jax
import numpy as np

from remind_jax.compiled.frame_step import settle_types
from remind_jax.config import Config
from remind_jax.decision import NO_ID, Outcome
from remind_jax.method import Method, get_method
from remind_jax.static import GROWTH_STEP, Static
from remind_jax.sweeps.program import (
    Answers,
    compile_follow,
    compiled_score,
    empty_memories,
    repeat,
    spread,
)
from remind_jax.sweeps.scene_arrays import NONE, SceneFrames
from remind_jax.sweeps.settings import Setting, stack

FRAMES_AT_ONCE = 16  # frames per call of the compiled program; scenes of all lengths share it
# On a CPU more settings side by side in a lane gain nothing: their memories leave the caches.
_MOST = {"cpu": 16}
_COPIES = 3.0  # memories that the program holds per setting, before it is measured
_LABELS_PER_SLOT = 2  # different ids at most, per object slot
_FEWEST_OBJECTS_SCORED, _FRAMES_SCORED_AT_ONCE = 8, 64  # scenes of up to so many share a program


def count_lanes() -> int:
    """Parts of a batch that run at the same time: the cores of one CPU, else one.

    No more than OMP_NUM_THREADS says, by which Ray and cluster queues tell a process its share.
    """
    if jax.default_backend() != "cpu" or jax.local_device_count() > 1:
        return 1
    allowed = getattr(os, "sched_getaffinity", None)
    cores = len(allowed(0)) if allowed else os.cpu_count() or 1
    share = os.environ.get("OMP_NUM_THREADS", "")
    return min(cores, int(share)) if share.isdecimal() and int(share) > 0 else cores


def most_at_once(method: Method, static: Static, budget_bytes: int) -> int:
    """Settings that memory may have room for, from the size of a memory; at least one."""
    memory = jax.eval_shape(lambda: settle_types(method.init(static)))
    size = sum(leaf.size * leaf.dtype.itemsize for leaf in jax.tree.leaves(memory))
    room = max(1, int(budget_bytes // (_COPIES * size)))
    most = count_lanes() * _MOST.get(jax.default_backend(), room)
    return jax.local_device_count() * min(room, most)


def plan_batch(
    frames: Any, config: Config, static: Static, wanted: int, budget_bytes: int
) -> tuple[int, int]:
    """How many settings go side by side within a budget, and the bytes that they take per device.

    Args:
      frames: A described scene.
      config: The method, and what a setting does not name.
      static: Capacities.
      wanted: Settings, a multiple of the number of devices; fewer if the compiled program needs
        more than the budget, but at least one per device.
      budget_bytes: Of each device.
    """
    devices = jax.local_device_count()
    method = get_method(config.tracker)
    batch = min(wanted, most_at_once(method, static, budget_bytes))
    part = next(_parts(pad_frames(frames, max(FRAMES_AT_ONCE, _num_frames(frames)))))
    while True:
        lanes = share_lanes(batch)
        size = _program_size(lanes)
        shapes = stack(config.thresholds, [{}] * size, static.scalar)
        needed = len(lanes) * compile_follow(method, static, size, shapes, part).num_bytes
        if batch == devices or needed <= budget_bytes:
            return batch, needed
        fitting = int(batch * budget_bytes / needed) // devices * devices
        batch = max(devices, min(batch - devices, fitting))


def share_lanes(num_settings: int) -> list[int]:
    """Settings of each lane, the first ones being the longest."""
    lanes = min(num_settings, count_lanes())
    return [-(-(num_settings - lane) // lanes) for lane in range(lanes)]


def _program_size(sizes: Sequence[int]) -> int:
    """Settings that the program of every lane takes; the last one fills it up.

    Two settings side by side on a CPU ended the process while they were compiled (once with "Cannot
    select" of LLVM); four and more did not.
    """
    is_alone = jax.default_backend() == "cpu" and jax.local_device_count() == 1
    return max(4, *sizes) if is_alone and max(sizes) > 1 else max(sizes)


def pad_frames(frames: Any, length: int) -> Any:
    """Adds empty frames at the end."""

    def pad(leaf: np.ndarray) -> np.ndarray:
        missing = [(0, length - len(leaf)), *((0, 0),) * (leaf.ndim - 1)]
        return np.pad(leaf, missing)

    return jax.tree.map(pad, frames)


def run_batch(
    frames: Any,
    config: Config,
    settings: Sequence[Setting],
    static: Static,
    budget_bytes: int | None = None,
) -> tuple[Answers | None, Static]:
    """Runs settings side by side; capacities grow until every frame fits every setting.

    Args:
      frames: A whole scene, described.
      config: The method, and what a setting does not name.
      settings: Settings of one batch.
      static: Capacities to start with.
      budget_bytes: Of each device; as much as it takes if left out.

    Returns:
      The answers of all frames and the capacities that they needed; no answers where so many
      settings with these capacities have no room in the budget.
    """
    method, length = get_method(config.tracker), _num_frames(frames)
    padded = pad_frames(frames, -(-length // FRAMES_AT_ONCE) * FRAMES_AT_ONCE)
    sizes = share_lanes(len(settings))
    lanes = []
    for first, size in zip(np.cumsum([0, *sizes]), sizes, strict=False):
        lane = [*settings[first : first + size], *[settings[-1]] * (_program_size(sizes) - size)]
        lanes.append(spread(stack(config.thresholds, lane, static.scalar)))
    while True:
        found, lacking = _follow_lanes(method, static, lanes, padded)
        if not any(lacking):
            found = [
                jax.tree.map(lambda leaf, size=size: leaf[:length, :size], lane)
                for lane, size in zip(found, sizes, strict=True)
            ]
            return jax.tree.map(lambda *parts: np.concatenate(parts, axis=1), *found), static
        static = static.grow(num_objects=lacking[0], num_pending=lacking[1])
        if budget_bytes is not None:
            fitting = max(jax.local_device_count(), most_at_once(method, static, budget_bytes))
            if len(settings) > fitting:
                return None, static


def _follow_lanes(
    method: Method, static: Static, lanes: Sequence[Any], frames: Any
) -> tuple[list[Answers], tuple[int, int]]:
    """The answers of every lane, or the slots that frames lack; then answers are of no use.

    Args:
      method: Of all.
      static: Capacities.
      lanes: Thresholds of as many settings each, stacked and on their devices.
      frames: All frames, a multiple of `FRAMES_AT_ONCE`.
    """
    num = len(jax.tree.leaves(lanes[0])[0])
    program = compile_follow(method, static, num, lanes[0], next(_parts(frames)))
    stopped = threading.Event()

    def follow(thresholds: Any) -> tuple[list[Answers], tuple[int, int]]:
        states, found = spread(empty_memories(method, static, num)), []
        for part in _parts(frames):
            states, answers = program.run(states, thresholds, repeat(part))
            found.append(jax.device_get(answers))
            lacking = int(found[-1].needed_objects.max()), int(found[-1].needed_pending.max())
            if any(lacking):
                stopped.set()
            if stopped.is_set():
                return found, lacking
        return found, (0, 0)

    if len(lanes) == 1:
        ran = [follow(lanes[0])]
    else:
        with ThreadPoolExecutor(len(lanes), "remind-jax sweeps") as pool:
            try:
                ran = list(pool.map(follow, lanes))
            except BaseException:  # Ctrl-C also
                stopped.set()
                raise
    found = [jax.tree.map(lambda *parts: np.concatenate(parts), *lane) for lane, _ in ran]
    objects, pending = zip(*(lacking for _, lacking in ran), strict=True)
    return found, (max(objects), max(pending))


def _num_frames(frames: Any) -> int:
    return len(jax.tree.leaves(frames)[0])


def _parts(frames: Any) -> Iterator[Any]:
    for first in range(0, _num_frames(frames), FRAMES_AT_ONCE):
        part = slice(first, first + FRAMES_AT_ONCE)
        yield jax.tree.map(lambda leaf, part=part: leaf[part], frames)


def score_batch(scene: SceneFrames, answers: Answers, static: Static) -> list[dict[str, float]]:
    """Scores of every setting of a batch, on the device.

    Frames and objects are filled up, so that scenes share what is compiled.
    """
    truth, (num_frames, num_settings, slots) = scene.truth, answers.outcome.shape
    more_frames = -num_frames % _FRAMES_SCORED_AT_ONCE
    lacking = slots - truth.object_index.shape[1]
    widen = lambda leaf: np.pad(  # noqa: E731
        leaf, ((0, more_frames), (0, lacking)), constant_values=NONE
    )
    more = ((0, more_frames), (0, 0), (0, 0))
    answers = dataclasses.replace(
        answers,
        outcome=np.pad(answers.outcome, more, constant_values=Outcome.EMPTY),
        object_id=np.pad(answers.object_id, more, constant_values=NO_ID),
        score=np.pad(answers.score, more),
    )
    num_labels, num_objects = _LABELS_PER_SLOT * static.num_objects, _FEWEST_OBJECTS_SCORED
    while num_objects < truth.num_objects:
        num_objects *= GROWTH_STEP
    while True:
        scores = compiled_score(
            widen(truth.object_index),
            widen(truth.class_id),
            answers,
            num_objects=num_objects,
            num_labels=num_labels,
        )
        if not scores["overflow"].any():
            break
        num_labels *= GROWTH_STEP
    names = [name for name in scores if name != "overflow"]
    return [{name: scores[name][index].item() for name in names} for index in range(num_settings)]
