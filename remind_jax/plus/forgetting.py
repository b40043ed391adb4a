"""Taking objects out of the memory of REMIND plus (host)."""

from __future__ import annotations

import dataclasses
from functools import partial
from typing import Any

import jax
import numpy as np
from jaxtyping import Int

from remind_jax.numerics.absent import NO_ID, NO_SLOT
from remind_jax.plus.state import PlusState
from remind_jax.plus.whitening import sum_up


def coming_ids(state: PlusState) -> Int[np.ndarray, "open"]:
    """What the tracklets that are not decided would be called as new objects."""
    tracklets = state.tracklets
    # On the host first: of arrays on a device, a program would be compiled.
    ids, alive, slot = jax.device_get((tracklets.id, tracklets.alive, tracklets.slot))
    return ids[alive & (slot == NO_SLOT) & (ids != NO_ID)]


def clear_objects(state: PlusState, empty: PlusState, slots: Int[np.ndarray, "slots"]) -> PlusState:
    """The memory without the objects in these slots: rows and relations are those of `empty`."""

    def clear_both(leaf: Any, blank: Any) -> np.ndarray:
        leaf, blank = _clear(leaf, blank, slots), np.asarray(blank)
        leaf[:, slots] = blank[:, slots]
        return leaf

    return dataclasses.replace(
        state,
        objects=jax.tree.map(partial(_clear, rows=slots), state.objects, empty.objects),
        pairs=jax.tree.map(clear_both, state.pairs, empty.pairs),
    )


def _clear(leaf: Any, blank: Any, rows: Int[np.ndarray, "rows"]) -> np.ndarray:
    leaf = np.array(leaf)
    leaf[rows] = np.asarray(blank)[rows]
    return leaf


def remove_objects(state: PlusState, empty: PlusState, ids: Int[np.ndarray, "ids"]) -> PlusState:
    """The memory without some objects: rows, relations and tracklets are those of `empty`.

    What was learned about all objects together stays; nothing of it shows a single object once the
    looks of the last frames are summed up as well.

    Args:
      ids: Of the objects, those of undecided tracklets among them.
    """
    scene, slot = state.scene, np.asarray(state.tracklets.slot)
    gone = np.isin(np.asarray(state.objects.id), ids)
    held = (slot != NO_SLOT) & gone[np.maximum(slot, 0)]
    held |= np.asarray(state.tracklets.is_open) & np.isin(np.asarray(state.tracklets.id), ids)
    clear_held = partial(_clear, rows=np.flatnonzero(held))
    recent = ("recent_looks", "looks_fade", "recent_steps", "steps_fade")
    summed = jax.jit(sum_up)  # operation by operation, each would be compiled
    return dataclasses.replace(
        clear_objects(state, empty, np.flatnonzero(gone)),
        tracklets=jax.tree.map(clear_held, state.tracklets, empty.tracklets),
        scene=dataclasses.replace(
            scene,
            total=summed(scene.total, scene.recent_looks, scene.looks_fade),
            within=summed(scene.within, scene.recent_steps, scene.steps_fade),
            **{name: getattr(empty.scene, name) for name in recent},
        ),
    )
