"""Taking one object out of a memory and out of what people are told of it."""

from __future__ import annotations

import dataclasses

import jax

from remind_jax.method import get_method
from remind_jax.session.announcement import Announcements
from remind_jax.session.memory_file import SavedMemory


def forget_object(memory: SavedMemory, object_id: int) -> SavedMemory:
    """The memory without an object and all that was merged into it; its records lose it as well.

    Args:
      memory: With the object.
      object_id: As announced.

    Raises:
      SourceError: If there is no such object.
      ConfigError: If the tracker cannot forget single objects.
    """
    records, announced = memory.records, memory.announced or Announcements()
    members = records.members(records.check_known(object_id))
    ids = [one for member in members for one in announced.memory_ids(member)]
    forgotten = get_method(memory.tracker).forget(memory.state, ids, memory.static)
    records.drop(object_id)
    return dataclasses.replace(memory, state=jax.tree.map(jax.numpy.asarray, forgotten))
