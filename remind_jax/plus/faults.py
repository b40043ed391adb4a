"""What is wrong with a memory of REMIND plus that was read from a file (host)."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from remind_jax.numerics.absent import NO_ID, NO_SLOT
from remind_jax.numerics.array_faults import not_unit, outside
from remind_jax.plus.state import LONG_AGO, PlusState


def find_faults(state: PlusState) -> Iterator[str]:
    """Phrases about values that no run makes; leaves are host arrays of the right shapes."""
    now = int(state.frame) - 1  # the last frame that was seen
    yield from _of_objects(state, now)
    yield from _of_tracklets(state, now)
    yield from _of_scene(state)
    pairs = state.pairs
    yield from outside("pairs.covisible", pairs.covisible, 0)
    yield from outside("pairs.spread", pairs.spread, 0)


def _of_objects(state: PlusState, now: int) -> Iterator[str]:
    objects = state.objects
    used = np.asarray(objects.id) != NO_ID
    yield from outside("objects.seen", objects.seen, 0, where=used)
    yield from outside("objects.last", objects.last, LONG_AGO, max(now, LONG_AGO), used)
    yield from outside("objects.size", objects.size, 0, where=used)
    yield from outside("objects.speed", objects.speed, 0, where=used)
    yield from outside("scene.speed", state.scene.speed, 0)
    yield from outside("objects.bank_count", objects.bank_count, 0)
    yield from outside("objects.ring_count", objects.ring_count, 0)
    kept = used[:, None] & (np.asarray(objects.bank_count) > 0)
    yield from not_unit("objects.white_bank", objects.white_bank, kept)


def _of_tracklets(state: PlusState, now: int) -> Iterator[str]:
    tracklets = state.tracklets
    alive = np.asarray(tracklets.alive)
    num_objects = len(np.asarray(state.objects.id))
    yield from outside("tracklets.slot", tracklets.slot, NO_SLOT, num_objects - 1, alive)
    held = alive & (np.asarray(tracklets.slot) != NO_SLOT)
    owners = np.asarray(state.objects.id)[np.maximum(np.asarray(tracklets.slot), 0)]
    yield from outside("objects.id of a tracklet", owners, 0, where=held)
    yield from outside("tracklets.last", tracklets.last, LONG_AGO, max(now, LONG_AGO), alive)
    yield from outside("tracklets.age", tracklets.age, 0, where=alive)
    yield from outside("tracklets.num_moves", tracklets.num_moves, 0, where=alive)
    yield from outside("tracklets.size", tracklets.size, 0, where=alive)
    yield from outside("tracklets.belief", tracklets.belief, 0, 1, alive)
    yield from outside("tracklets.trust", tracklets.trust, 0, 1, alive)
    yield from outside("tracklets.met", tracklets.met, 0, where=alive)
    yield from outside("tracklets.ring_count", tracklets.ring_count, 0, where=alive)


def _of_scene(state: PlusState) -> Iterator[str]:
    scene = state.scene
    for name in ("num_looks", "total_weight", "within_weight", "num_rings"):
        yield from outside(f"scene.{name}", getattr(scene, name), 0)
    yield from outside("scene.newness", scene.newness, 0, 1)
    yield from outside("scene.faded", scene.faded, 0, 1)
    yield from outside("scene.raised", scene.raised, 0, 1)
