"""Two memories become one: the objects of another memory come to those at rest (host).

Rule: method_plus.md#joining.
"""

from __future__ import annotations

import dataclasses

import jax
import numpy as np
from jaxtyping import Int

from remind_jax.method import Joined
from remind_jax.numerics.absent import NO_SLOT
from remind_jax.plus import thresholds as th
from remind_jax.plus.archive import NO_PARTNERS, Resting
from remind_jax.plus.memory_matching import NOBODY, Side, match
from remind_jax.plus.recall import ObjectsAtRest
from remind_jax.plus.state import PlusState


def join(
    state: PlusState,
    at_rest: ObjectsAtRest,
    other: PlusState,
    other_at_rest: ObjectsAtRest,
    class_ids: Int[np.ndarray, "classes"],
    t: th.PlusThresholds,
) -> tuple[PlusState, Joined]:
    """Takes in all objects of another memory as objects at rest, and finds those that are known.

    Args:
      state: This memory.
      at_rest: Its objects at rest, to which the others come.
      other: The other memory.
      other_at_rest: Its objects at rest.
      class_ids: What its classes are here.
      t: Weights of the evidence.

    Returns:
      This memory, in which only the next id is another one, and what was found.
    """
    state, other = jax.device_get((state, other))
    here, partners_here = at_rest.archive.with_working_set(state)
    there, partners_there = other_at_rest.archive.with_working_set(other)
    there |= {one.id: one for one in _ended(other, t.decision)}
    shift, later = int(state.next_id), int(state.frame) - int(other.frame)
    moved = {one: _moved(of_one, shift, later, class_ids) for one, of_one in there.items()}
    partners = {one + shift: _renamed(partners_there.get(one, NO_PARTNERS), shift) for one in there}
    state = dataclasses.replace(state, next_id=np.int32(shift + int(other.next_id)))
    matched: list[tuple[int, int]] = []
    ambiguous: dict[int, tuple[int, ...]] = {}
    known = Side.of(here, partners_here)
    added = Side.of({one.id: one for one in moved.values()}, partners)
    if known.objects and added.objects:
        ids, new_ids = ([one.id for one in side.objects] for side in (known, added))
        row, doubted = match(known, added, state.scene, t)
        matched = [(ids[row[m]], new_ids[m]) for m in np.flatnonzero(row != NOBODY)]
        ambiguous = {new_ids[m]: tuple(ids[r] for r in rows) for m, rows in doubted.items()}
    at_rest.archive.take_in(list(moved.values()), partners, state)
    return state, Joined({one: one + shift for one in there}, tuple(matched), ambiguous)


def _moved(one: Resting, shift: int, later: int, class_ids: Int[np.ndarray, "classes"]) -> Resting:
    """An object under its id here, last seen as long ago as it was there."""
    changed = {
        "id": one.values["id"] + np.int32(shift),
        "class_id": np.int32(class_ids[one.values["class_id"]]),
        "last": one.values["last"] + np.int32(later),
    }
    return dataclasses.replace(
        one, values=one.values | {name: np.asarray(value) for name, value in changed.items()}
    )


def _renamed(partners: np.ndarray, shift: int) -> np.ndarray:
    partners = partners.copy()
    partners["id"] += shift
    return partners


def _ended(state: PlusState, t: th.Decision) -> list[Resting]:
    """What its open tracklets leave behind as they cannot resume (`evidence.find_ended`)."""
    tracklets = state.tracklets
    is_open = tracklets.alive & (tracklets.slot == NO_SLOT) & tracklets.leans_new
    rows = np.flatnonzero(is_open & (t.ended_age > 0) & (tracklets.age >= t.ended_age))
    found = []
    for row in rows.tolist():
        values = {
            name: np.array(getattr(tracklets, name)[row])
            for name in ("id", "class_id", "last", "size")
        }
        values |= {"seen": np.int32(0), "visits": np.int32(1), "speed": np.float32(0)}
        values |= {"class_lead": np.int32(1)}
        values |= {"ring": np.zeros_like(tracklets.ring[row]), "ring_count": np.int32(0)}
        values = {name: np.asarray(value) for name, value in values.items()}
        look = np.array(tracklets.look[row])
        found.append(Resting(values, look[None], np.ones(1, np.int32)))
    return found
