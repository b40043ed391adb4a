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
    for name in ("seen", "size", "speed"):
        yield from outside(f"objects.{name}", getattr(objects, name), 0, where=used)
    yield from outside("objects.last", objects.last, LONG_AGO, max(now, LONG_AGO), used)
    for name in ("bank_count", "ring_count"):
        yield from outside(f"objects.{name}", getattr(objects, name), 0)
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
    for name in ("age", "num_moves", "size", "met", "ring_count"):
        yield from outside(f"tracklets.{name}", getattr(tracklets, name), 0, where=alive)
    for name in ("belief", "trust"):
        yield from outside(f"tracklets.{name}", getattr(tracklets, name), 0, 1, alive)


def _of_scene(state: PlusState) -> Iterator[str]:
    scene = state.scene
    for name in ("num_looks", "total_weight", "within_weight", "num_rings", "speed"):
        yield from outside(f"scene.{name}", getattr(scene, name), 0)
    for name in ("newness", "faded", "raised"):
        yield from outside(f"scene.{name}", getattr(scene, name), 0, 1)
