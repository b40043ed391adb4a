"""Runs one scene under many settings, as many at once as memory allows.

On a CPU a batch is shared between its cores: each takes some settings through the frames in a
thread of its own. Kernels of a step are too small to be shared one by one.
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
    SCORES,
    Answers,
    compile_follow,
    compiled_score,
    empty_memories,
    goes_in_turn,
    repeat,
    spread,
)
from remind_jax.sweeps.scene_arrays import NONE, SceneFrames
from remind_jax.sweeps.settings import Setting, stack

FRAMES_AT_ONCE = 16  # frames per call of the compiled program; scenes of all lengths share it
# On a CPU more settings side by side on a core gain nothing: their memories leave the caches.
_MOST = {"cpu": 16}
# One after the other they gain nothing at all, so that results come early.
_MOST_IN_TURN = 2
_COPIES = 3.0  # memories that the program holds per setting, before it is measured
_LABELS_PER_SLOT = 2  # different ids at most, per object slot
_FEWEST_OBJECTS_SCORED, _FRAMES_SCORED_AT_ONCE = 8, 64  # scenes of up to so many share a program


def count_cores() -> int:
    """Programs that run at the same time: one per core of the CPU, one elsewhere.

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
    room, cores = max(1, int(budget_bytes // (_COPIES * size))), count_cores()
    if _is_one_each(method):
        return _MOST_IN_TURN * cores if room >= cores else room
    most = cores * _MOST.get(jax.default_backend(), room)
    return jax.local_device_count() * min(room, most)


def plan_batch(
    frames: Any, config: Config, static: Static, wanted: int, budget_bytes: int
) -> tuple[int, int]:
    """How many settings make a batch within a budget, and the bytes that it takes per device.

    They are those wanted, a multiple of the number of devices, which has the budget each; fewer if
    the compiled program needs more, but at least one per device.
    """
    devices = jax.local_device_count()
    method = get_method(config.tracker)
    batch = min(wanted, most_at_once(method, static, budget_bytes))
    part = next(_parts(pad_frames(frames, max(FRAMES_AT_ONCE, _num_frames(frames)))))
    while True:
        size = program_size(method, batch)
        shapes = stack(config.thresholds, [{}] * size, static.scalar)
        programs = min(count_cores(), -(-batch // size))
        needed = programs * compile_follow(method, static, size, shapes, part).num_bytes
        if batch == devices or needed <= budget_bytes:
            return batch, needed
        fitting = int(batch * budget_bytes / needed) // devices * devices
        batch = max(devices, min(batch - devices, fitting))


def program_size(method: Method, num_settings: int) -> int:
    """Settings that one program takes of a batch of so many.

    Two settings side by side on a CPU ended the process while they were compiled (once with "Cannot
    select" of LLVM); four and more did not.
    """
    if _is_one_each(method):
        return 1
    share = -(-num_settings // count_cores())
    is_alone = jax.default_backend() == "cpu" and jax.local_device_count() == 1
    return max(4, share) if is_alone and share > 1 else share


def _is_one_each(method: Method) -> bool:
    """Whether a program takes one setting: where they go one after the other anyway."""
    return goes_in_turn(method) and jax.local_device_count() == 1


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
    batch: int | None = None,
    budget_bytes: int | None = None,
) -> tuple[Answers | None, Static]:
    """Runs the settings of a batch; capacities grow until every frame fits.

    Args:
      frames: A whole scene, described.
      batch: Settings of a full batch, whose program serves; as many as there are if left out.
      budget_bytes: Of each device; as much as it takes if left out.

    Returns:
      The answers of all frames and the capacities that they needed; no answers where so many
      settings with these capacities have no room in the budget.
    """
    method, length, num = get_method(config.tracker), _num_frames(frames), len(settings)
    padded = pad_frames(frames, -(-length // FRAMES_AT_ONCE) * FRAMES_AT_ONCE)
    size, lock, stopped = program_size(method, batch or num), threading.Lock(), threading.Event()

    def grow(needed: dict[str, int]) -> None:
        nonlocal static
        with lock:
            static = static.grow(**needed)
        if budget_bytes is not None:
            most = most_at_once(method, static, budget_bytes)
            if num > max(jax.local_device_count(), most):
                stopped.set()

    def follow(first: int) -> Answers | None:
        some = [*settings[first : first + size], *[settings[-1]] * (first + size - num)]
        thresholds = spread(stack(config.thresholds, some, static.scalar))
        while not stopped.is_set():
            answers, needed = _follow(method, static, thresholds, padded, stopped)
            if answers is not None:
                return jax.tree.map(lambda leaf: leaf[:length, : num - first], answers)
            grow(needed)
        return None

    starts = range(0, num, size)
    if len(starts) == 1:
        found = [follow(0)]
    else:
        with ThreadPoolExecutor(count_cores(), "remind-jax sweeps") as pool:
            try:
                found = list(pool.map(follow, starts))
            except BaseException:  # Ctrl-C also
                stopped.set()
                raise
    if stopped.is_set():
        return None, static
    return jax.tree.map(lambda *parts: np.concatenate(parts, axis=1), *found), static


def _follow(
    method: Method, static: Static, thresholds: Any, frames: Any, stopped: threading.Event
) -> tuple[Answers | None, dict[str, int]]:
    """The answers of the settings of one program, or the slots that a frame lacks.

    Thresholds of the settings are stacked and on their devices, frames a multiple of
    `FRAMES_AT_ONCE`; nothing is of use any more once `stopped` is set.
    """
    num = len(jax.tree.leaves(thresholds)[0])
    program = compile_follow(method, static, num, thresholds, next(_parts(frames)))
    states, found = spread(empty_memories(method, static, num)), []
    for part in _parts(frames):
        states, answers = program.run(states, thresholds, repeat(part))
        found.append(jax.device_get(answers))
        needed = {
            "num_objects": int(found[-1].needed_objects.max()),
            "num_pending": int(found[-1].needed_pending.max()),
        }
        if any(needed.values()) or stopped.is_set():
            return None, needed
    return jax.tree.map(lambda *parts: np.concatenate(parts), *found), {}


def _num_frames(frames: Any) -> int:
    return len(jax.tree.leaves(frames)[0])


def _parts(frames: Any) -> Iterator[Any]:
    for first in range(0, _num_frames(frames), FRAMES_AT_ONCE):
        part = slice(first, first + FRAMES_AT_ONCE)
        yield jax.tree.map(lambda leaf, part=part: leaf[part], frames)


def score_batch(
    scene: SceneFrames, answers: Answers, static: Static, batch: int
) -> list[dict[str, float]]:
    """Scores of every setting, on the device.

    Frames, objects and settings (up to a full batch) are filled up, so that scenes and batches
    share what is compiled.
    """
    num_frames, num_settings, slots = answers.outcome.shape
    more_frames = -num_frames % _FRAMES_SCORED_AT_ONCE
    lacking = slots - scene.object_index.shape[1]
    widened = ((0, more_frames), (0, lacking))
    object_index = np.pad(scene.object_index, widened, constant_values=NONE)
    more = ((0, more_frames), (0, batch - num_settings), (0, 0))
    ids = answers.object_id
    # Ids may begin anywhere and leave gaps, for which labels would have no room.
    label = np.where(ids < 0, NO_ID, np.searchsorted(np.unique(ids[ids >= 0]), ids))
    answers = dataclasses.replace(answers, object_id=label.astype(ids.dtype), evidence={})
    absent = jax.tree.unflatten(jax.tree.structure(answers), (Outcome.EMPTY, NO_ID, 0, 0, 0))
    filled = jax.tree.map(
        lambda leaf, value: np.pad(leaf, more[: leaf.ndim], constant_values=value), answers, absent
    )
    num_labels, num_objects = _LABELS_PER_SLOT * static.num_objects, _FEWEST_OBJECTS_SCORED
    while num_objects < scene.num_objects:
        num_objects *= GROWTH_STEP
    while True:
        scores = compiled_score(
            object_index, filled, num_objects=num_objects, num_labels=num_labels
        )
        if not scores["overflow"].any():
            break
        num_labels *= GROWTH_STEP
    # The last bits depend on the size of the batch, and settings are ranked by these scores.
    return [
        {name: round(scores[name][index].item(), 6) for name in SCORES}
        for index in range(num_settings)
    ]
