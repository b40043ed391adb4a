"""Taking objects out of the memory of REMIND plus (host)."""

from __future__ import annotations

import dataclasses

import jax
import numpy as np
from jaxtyping import Bool, Int

from remind_jax.numerics.absent import NO_ID, NO_SLOT
from remind_jax.plus.state import PlusState
from remind_jax.plus.whitening import sum_up


def coming_ids(state: PlusState) -> Int[np.ndarray, "open"]:
    """What the tracklets that are not decided would be called as new objects."""
    tracklets = state.tracklets
    # On the host first: of arrays on a device, a program would be compiled.
    ids, alive, slot = jax.device_get((tracklets.id, tracklets.alive, tracklets.slot))
    return ids[alive & (slot == NO_SLOT) & (ids != NO_ID)]


def remove_objects(state: PlusState, empty: PlusState, ids: Int[np.ndarray, "ids"]) -> PlusState:
    """The memory without some objects: their rows, relations and tracklets are those of `empty`.

    What was learned about all objects together stays; nothing of it shows a single object once the
    looks of the last frames are summed up as well.

    Args:
      state: The memory.
      empty: A memory without objects, of the same capacities.
      ids: Of the objects, those of undecided tracklets among them.
    """
    gone = np.isin(np.asarray(state.objects.id), ids)

    def clear(where: Bool[np.ndarray, "rows"], leaves: object, blank: object) -> object:
        def clear_leaf(leaf: jax.Array, none: jax.Array) -> np.ndarray:
            rows = where.reshape(-1, *[1] * (leaf.ndim - 1))
            return np.where(rows, np.asarray(none), np.asarray(leaf))

        return jax.tree.map(clear_leaf, leaves, blank)

    def clear_pairs(leaf: jax.Array, none: jax.Array) -> np.ndarray:
        either = gone[:, None] | gone[None]
        either = either.reshape(*either.shape, *[1] * (leaf.ndim - 2))
        return np.where(either, np.asarray(none), np.asarray(leaf))

    scene, slot = state.scene, np.asarray(state.tracklets.slot)
    held = (slot != NO_SLOT) & gone[np.maximum(slot, 0)]
    held |= np.asarray(state.tracklets.is_open) & np.isin(np.asarray(state.tracklets.id), ids)
    return dataclasses.replace(
        state,
        objects=clear(gone, state.objects, empty.objects),
        pairs=jax.tree.map(clear_pairs, state.pairs, empty.pairs),
        tracklets=clear(held, state.tracklets, empty.tracklets),
        scene=dataclasses.replace(
            state.scene,
            total=sum_up(scene.total, scene.recent_looks, scene.looks_fade),
            within=sum_up(scene.within, scene.recent_steps, scene.steps_fade),
            recent_looks=empty.scene.recent_looks,
            looks_fade=empty.scene.looks_fade,
            recent_steps=empty.scene.recent_steps,
            steps_fade=empty.scene.steps_fade,
        ),
    )
