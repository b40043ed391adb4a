"""A memory is changed as a whole: the objects of another one come along, or an object goes.

Of those that come along, the ones that are known are merged.
"""

from __future__ import annotations

import copy
import dataclasses
from pathlib import Path
from typing import Any

import jax
import numpy as np

from remind_jax.errors import ConfigError, RemindError
from remind_jax.method import Joined, Joining, get_method
from remind_jax.numerics.absent import NO_ID
from remind_jax.session import memory_fit
from remind_jax.session.memory_file import SavedMemory


@dataclasses.dataclass(frozen=True)
class JoinedObjects(Joined):
    """What became of the objects of another memory; ids are those of the answers."""

    @property
    def num_added(self) -> int:
        """Objects that came."""
        return len(self.ids)


def join_memories(
    memory: SavedMemory, other: SavedMemory, path: str | Path, thresholds: Any = None
) -> tuple[SavedMemory, JoinedObjects]:
    """One memory with the objects of both; what is known in both is merged, and can be split again.

    Args:
      memory: Goes on as what is returned, and is not changed; its ids stay.
      other: Its objects get ids that are free, its sessions follow those of `memory`.
      thresholds: Of the tracker; the published ones if left out.

    Raises:
      ConfigError: If the tracker cannot join memories.
      RemindError: If the memories are of different trackers, backbones or widths of features.
    """
    method = get_method(memory.tracker)
    memory_fit.check_tracker(other, memory.tracker, path)
    if memory.class_names:
        is_agnostic = memory_fit.was_made_without_classes(memory)
        advice = f"join memories made {'without' if is_agnostic else 'with'} them"
        memory_fit.check_classes(other, is_agnostic, path, advice)
    memory_fit.check_backbone(other, memory.backbone, memory.fingerprint, path)
    if method.host.join is None or memory.at_rest is None or other.at_rest is None:
        raise ConfigError(
            f"tracker '{memory.tracker}' cannot join memories; trackers that keep objects at rest "
            "can, as 'plus' does"
        )
    if other.static.feature_dim != memory.static.feature_dim:
        raise RemindError(
            f"{path} knows features of {other.static.feature_dim} numbers, not "
            f"{memory.static.feature_dim}; join memories of the same features"
        )
    memory = dataclasses.replace(
        memory, at_rest=copy.deepcopy(memory.at_rest), records=copy.deepcopy(memory.records)
    )
    new = (one for one in other.class_names if one not in memory.class_names)
    class_names = (*memory.class_names, *new)
    class_ids = np.array([class_names.index(one) for one in other.class_names], int)
    thresholds = method.settings() if thresholds is None else thresholds
    sides = [Joining(one.state, one.at_rest, _merged_into(one)) for one in (memory, other)]
    state, joined = method.host.join(*sides, class_ids, thresholds)
    announced, number_of = memory.announced.joined(other.announced, joined.ids)
    records = memory.records
    records.take_in(other.records, number_of)

    def told(one: int) -> int:
        number = announced.id_of(one)
        return records.merged_into.get(number, number) if records.has(number) else NO_ID

    found = [(told(kept), told(gone)) for kept, gone in joined.matched]
    matched = records.unite([pair for pair in found if NO_ID not in pair])
    ambiguous = {
        told(one): tuple(dict.fromkeys(told(known) for known in may_be if told(known) != NO_ID))
        for one, may_be in joined.ambiguous.items()
        if told(one) != NO_ID
    }
    changed = dataclasses.replace(
        memory,
        state=jax.device_put(state),
        class_names=class_names,
        announced=announced,
        fingerprint=memory.fingerprint or other.fingerprint,
    )
    # Objects that were never answered come as well, but nobody has an id of theirs.
    ids = {there: here for there, here in number_of.items() if records.has(here)}
    return changed, JoinedObjects(ids, matched, ambiguous)


def _merged_into(memory: SavedMemory) -> dict[int, int]:
    """What was declared to be another object, and which, by the ids of the tracker."""
    return {
        one: kept
        for gone, into in memory.records.merged_into.items()
        for kept in memory.announced.memory_ids(into)[:1]
        for one in memory.announced.memory_ids(gone)
    }


def forget_object(memory: SavedMemory, object_id: int) -> SavedMemory:
    """The memory without an object and what was merged into it; its records lose it as well.

    Raises:
      SourceError: If there is no such object.
      ConfigError: If the tracker cannot forget single objects.
    """
    records = memory.records
    members = records.members(records.check_known(object_id))
    ids = [one for member in members for one in memory.announced.memory_ids(member)]
    forgotten = get_method(memory.tracker).forget(memory.state, ids, memory.static)
    if memory.at_rest is not None:
        memory.at_rest.forget(ids)
    records.drop(object_id)
    return dataclasses.replace(memory, state=jax.device_put(forgotten))
