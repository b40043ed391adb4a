"""Two memories become one: the objects of another memory come to those at rest (host).

Rule: method_plus.md#joining.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any

import jax
import numpy as np
from jaxtyping import Int

from remind_jax.method import Joined, Joining
from remind_jax.plus import thresholds as th
from remind_jax.plus.archive import NO_PARTNERS, Resting
from remind_jax.plus.evidence import leaves_object
from remind_jax.plus.memory_matching import NOBODY, Side, match
from remind_jax.plus.state import PlusState


def join(
    this: Joining, that: Joining, class_ids: Int[np.ndarray, "classes"], t: th.PlusThresholds
) -> tuple[PlusState, Joined]:
    """Takes in the objects of another memory as objects at rest, and finds those that are known.

    Args:
      this: This memory, to whose objects at rest the others come.
      that: The other memory; what came from this one, or from where this one has it, stays away.
      class_ids: What its classes are here.

    Returns:
      This memory, in which only the next id is another one, and what was found.
    """
    state, other = jax.device_get((this.state, that.state))
    here, partners_here = this.at_rest.with_working_set(state)
    there, partners_there = that.at_rest.with_working_set(other)
    there |= {one.id: one for one in _ended(other, t.decision)}
    coming = here | {one.id: one for one in _ended(state, t.decision)}
    copies = _find_copies(coming, there, class_ids)
    new = [one for one in there if one not in copies]
    first, later = int(state.next_id), int(state.frame) - int(other.frame)
    ids = {one: first + place for place, one in enumerate(new)} | copies
    moved = [_moved(there[one], ids[one], later, class_ids) for one in new]
    partners = {ids[one]: _renamed(partners_there.get(one, NO_PARTNERS), ids) for one in new}
    state = dataclasses.replace(state, next_id=np.int32(first + len(new)))
    # What was declared one there is so here, with all that it was declared to be here.
    declared = {
        ids[one]: this.merged_into.get(copies[old], copies[old])
        for pair in that.merged_into.items()
        for old, one in (pair, pair[::-1])
        if old in copies and one in new
    }
    matched = [(known, one) for one, known in declared.items()]
    ambiguous: dict[int, tuple[int, ...]] = {}
    known = Side.of(here, partners_here, this.merged_into)
    # What an object was declared to be may be gone; no id here is negative.
    merged = {
        ids[gone]: ids.get(kept, -1 - kept)
        for gone, kept in that.merged_into.items()
        if gone in ids
    }
    asking = {one.id: one for one in moved if not {one.id, merged.get(one.id)} & declared.keys()}
    added = Side.of(asking, partners, merged)
    if known.objects and added.objects:
        row, doubted = match(known, added, state.scene, t)
        known_ids, new_ids = ([one.id for one in side.objects] for side in (known, added))
        matched += [(known_ids[row[m]], new_ids[m]) for m in np.flatnonzero(row != NOBODY)]
        ambiguous = {new_ids[m]: tuple(known_ids[r] for r in rows) for m, rows in doubted.items()}
    this.at_rest.take_in(moved, partners, state)
    return state, Joined({one: ids[one] for one in new}, tuple(matched), ambiguous)


def _find_copies(
    here: Mapping[int, Resting],
    there: Mapping[int, Resting],
    class_ids: Int[np.ndarray, "classes"],
) -> dict[int, int]:
    """Objects that were joined before and were not seen since, and their ids here."""

    def key_of(class_id: int, one: Resting) -> tuple[int, bytes]:
        return class_id, one.bank.tobytes()

    # A bank may stay as it was though its object was seen: few frames of a visit are kept.
    known: dict[tuple[int, bytes], Resting] = {}
    for one in sorted(here.values(), key=_num_seen):
        if len(one.bank):
            known[key_of(int(one.values["class_id"]), one)] = one
    keys = {
        one: key_of(int(class_ids[of_one.values["class_id"]]), of_one)
        for one, of_one in there.items()
    }
    return {
        one: known[key].id
        for one, key in keys.items()
        if key in known and _num_seen(there[one]) <= _num_seen(known[key])
    }


def _num_seen(one: Resting) -> int:
    return int(one.values["seen"])


def _moved(one: Resting, new_id: int, later: int, class_ids: Int[np.ndarray, "classes"]) -> Resting:
    """An object under its id here, last seen as long ago as it was there."""
    changed = {
        "id": np.int32(new_id),
        "class_id": np.int32(class_ids[one.values["class_id"]]),
        "last": one.values["last"] + np.int32(later),
    }
    return dataclasses.replace(
        one, values=one.values | {name: np.asarray(value) for name, value in changed.items()}
    )


def _renamed(partners: np.ndarray, ids: Mapping[int, int]) -> np.ndarray:
    partners = partners[np.isin(partners["id"], list(ids))]
    partners["id"] = [ids[one] for one in partners["id"].tolist()]
    return partners


def _ended(state: PlusState, t: th.Decision) -> list[Resting]:
    """What its open tracklets leave behind, as none of them can resume."""
    tracklets: Any = state.tracklets
    unseen = {"seen": np.int32(0), "visits": np.int32(1), "class_lead": np.int32(1)}
    unseen |= {"speed": np.float32(0), "ring_count": np.int32(0)}
    found = []
    for row in np.flatnonzero(leaves_object(tracklets, t)).tolist():
        known = {name: getattr(tracklets, name)[row] for name in ("id", "class_id", "last", "size")}
        values = {**known, **unseen, "ring": np.zeros_like(tracklets.ring[row])}
        values = {name: np.array(value) for name, value in values.items()}
        found.append(Resting(values, tracklets.look[[row]], np.ones(1, np.int32)))
    return found
