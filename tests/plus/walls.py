"""A wall of things that a camera pans along: detections of REMIND plus without any image."""

import dataclasses
import functools
import operator
from typing import Any

import jax
import numpy as np

from remind_jax.plus.observation import Motion, Sightings
from remind_jax.plus.state import PlusState, blank, init
from remind_jax.plus.thresholds import PlusThresholds
from remind_jax.plus.tracker import advance
from remind_jax.static import Static
from tests.statics import change_parts

DIM = 6
STATIC = Static(num_detections=6, num_objects=24, feature_dim=DIM)
NO_TRUTH = -1
BLOCK = 5  # frames; lengths of walks and cuts in them are multiples


@dataclasses.dataclass(frozen=True)
class Walk:
    """Frames `[T, N]` and which thing every detection is."""

    sightings: Sightings
    motion: Motion
    thing: np.ndarray  # [T, N], NO_TRUTH in empty slots


def pan(
    seed: int = 0,
    *,
    num_things: int = 10,
    frames: int = 90,
    lost: float = 0.0,
    alike: bool = False,
) -> Walk:
    """There, back, and there again along things at random places, seen with noise.

    Args:
      seed: Of everything drawn.
      num_things: Things on the wall.
      frames: Frames in all.
      lost: Share of the detections that are missing.
      alike: All things look the same, so that only their places differ.
    """
    rng = np.random.default_rng(seed)
    place = np.stack([np.linspace(1, 13, num_things), rng.uniform(1, 4, num_things)], axis=1)
    look = rng.normal(size=(num_things, DIM)) * (0 if alike else 1) + 3
    size = rng.uniform(0.4, 0.8, num_things)
    camera = 4 + 4 * np.cos(np.linspace(0, 3 * np.pi, frames) + np.pi)
    num = STATIC.num_detections
    walk = _empty(frames, num)
    thing = np.full((frames, num), NO_TRUTH)
    for t in range(frames):
        center = place - (camera[t], 0)
        inside = (center[:, 0] > 0.4) & (center[:, 0] < 6.0)
        seen = np.flatnonzero(inside & (rng.random(num_things) >= lost))[:num]
        k = np.arange(len(seen))
        thing[t, k] = seen
        jitter = rng.normal(0, 0.02, (len(seen), 2))
        half = size[seen, None] / 2
        walk["center"][t, k] = center[seen] + jitter
        walk["box"][t, k] = np.concatenate([center[seen] - half, center[seen] + half], 1)
        walk["size"][t, k] = size[seen]
        walk["look"][t, k] = look[seen] + rng.normal(0, 0.15, (len(seen), DIM))
        walk["ring"][t, k] = 1 + rng.normal(0, 0.1, (len(seen), DIM))
        walk["valid"][t, k] = walk["has_ring"][t, k] = True
    matrix = np.tile(np.eye(2, 3, dtype=np.float32), (frames, 1, 1))
    matrix[1:, 0, 2] = -np.diff(camera)
    size_px = np.tile(np.int32([480, 640]), (frames, 1))
    motion = Motion(matrix, np.full(frames, 0.9, np.float32), size_px, np.ones(frames, np.float32))
    return Walk(Sightings(**walk), motion, thing)


def _empty(frames: int, num: int) -> dict[str, np.ndarray]:
    """The fields of frames in which nothing is seen."""
    center = np.array([3.2, 2.4], np.float32)
    nothing = blank(Sightings, {"N": num, "D": DIM, "G": 0}, size=0.01, frame_center=center)
    return {name: np.repeat(leaf[None], frames, 0) for name, leaf in vars(nothing).items()}


@functools.partial(jax.jit, static_argnames="static")
def scan_block(state, walk, thresholds, static):
    """The memory after some frames, and verdicts, decisions and overflow of each."""

    def one(state, frame):
        sightings, motion = frame
        state, verdicts = advance(
            state, sightings, motion, sightings.valid, static=static, thresholds=thresholds
        )
        return state, (verdicts, state.decisions, state.overflow)

    return jax.lax.scan(one, state, walk)


def follow(
    walk: Walk,
    thresholds: PlusThresholds | None = None,
    static: Static = STATIC,
    state: PlusState | None = None,
) -> tuple[Any, Any, Any, Any]:
    """The memory in the end, and verdicts, decisions and overflow of every frame.

    In blocks of frames, so that walks of all lengths share a program.
    """
    state = init(static) if state is None else state
    told = []
    for first in range(0, len(walk.thing), BLOCK):
        block = jax.tree.map(
            operator.itemgetter(slice(first, first + BLOCK)), (walk.sightings, walk.motion)
        )
        state, answers = scan_block(state, block, thresholds or PlusThresholds(), static)
        told.append(jax.device_get(answers))
    return state, *jax.tree.map(lambda *leaves: np.concatenate(leaves), *told)


def glimpse(walk: Walk, thing: int, shown: np.ndarray) -> Walk:
    """The same walk with one thing seen in these frames only."""
    gone = (walk.thing == thing) & ~np.isin(np.arange(len(walk.thing)), shown)[:, None]
    seen = change_parts(walk, sightings={"valid": walk.sightings.valid & ~gone})
    return dataclasses.replace(seen, thing=np.where(gone, NO_TRUTH, walk.thing))


def displace(walk: Walk, thing: int, since: int, offset: tuple[float, float]) -> Walk:
    """The same walk, in which somebody has moved a thing before frame `since`."""
    moved = (walk.thing == thing) & (np.arange(len(walk.thing)) >= since)[:, None]
    shift = np.where(moved[..., None], np.float32(offset), np.float32(0))
    center, box = walk.sightings.center + shift, walk.sightings.box + np.tile(shift, 2)
    return change_parts(walk, sightings={"center": center, "box": box})


def split(walk: Walk, thing: int, frame: int) -> Walk:
    """The same walk; in one frame a thing is two halves, in the next only the upper one is seen."""
    fields = {f.name: getattr(walk.sightings, f.name).copy() for f in dataclasses.fields(Sightings)}
    truth = walk.thing.copy()
    upper = int(np.flatnonzero(truth[frame] == thing)[0])
    lower = int(np.flatnonzero(truth[frame] == NO_TRUTH)[0])
    later = int(np.flatnonzero(truth[frame + 1] == thing)[0])
    for values in fields.values():
        if values.ndim > 1 and values.shape[1] == truth.shape[1]:
            values[frame, lower] = values[frame, upper]
    truth[frame, lower] = thing
    quarter = fields["size"][frame, upper] / 4
    for t, row, side in ((frame, upper, -1), (frame, lower, 1), (frame + 1, later, -1)):
        fields["center"][t, row, 1] += side * quarter
        fields["box"][t, row, 2 - side] += 2 * side * quarter
        fields["size"][t, row] *= 0.7
    fields["look"][frame + 1, later, 0] += 1.5
    fields["look"][frame, upper] = fields["look"][frame + 1, later]
    return Walk(Sightings(**fields), walk.motion, truth)
