"""What is wrong with a memory of the paper's tracker that was read from a file (host)."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from remind_jax.numerics.absent import NEVER, NO_ID
from remind_jax.numerics.array_faults import not_unit, outside
from remind_jax.remind.memory.objects import Lifecycle
from remind_jax.remind.memory.pending import Kind
from remind_jax.remind.perception.relations import Contact
from remind_jax.remind.state import TrackerState

_BANKS = ("appearance", "parts", "rings", "ring_prototypes")


def find_faults(state: TrackerState) -> Iterator[str]:
    """Phrases about values that no run makes; leaves are host arrays of the right shapes."""
    now = int(state.frame) - 1  # the last frame that was seen
    yield from _of_objects(state, now)
    yield from _of_pending(state)
    yield from _of_graphs(state, now)
    for name in _BANKS:
        if getattr(state, name) is not None:
            for half in ("work", "stable"):
                yield from _of_bank(f"{name}.{half}", getattr(getattr(state, name), half), now)


def _of_objects(state: TrackerState, now: int) -> Iterator[str]:
    objects = state.objects
    used = np.asarray(objects.id) != NO_ID
    ids = np.asarray(objects.id)[used]
    if not used[: len(ids)].all() or (np.diff(ids) <= 0).any():
        yield "'objects.id' is not in order; allowed: rising ids in the first slots"
    yield from outside("objects.lifecycle", objects.lifecycle, 0, max(Lifecycle), used)
    for name in ("hits", "misses", "age"):
        yield from outside(f"objects.{name}", getattr(objects, name), 0, where=used)
    yield from outside("objects.last_seen", objects.last_seen, NEVER, max(now, NEVER), used)


def _of_pending(state: TrackerState) -> Iterator[str]:
    pending = state.pending
    used = np.asarray(pending.kind) != Kind.FREE
    yield from outside("pending.kind", pending.kind, Kind.FREE, max(Kind))
    yield from outside("pending.id", pending.id, 0, where=used)
    yield from outside("pending.hits", pending.hits, 0, where=used)
    yield from outside("pending.area", pending.area, 0, where=used)
    last_id = int(state.next_id) - 1
    yield from outside(
        "pending.known_id", pending.known_id, NO_ID, max(last_id, NO_ID), used[:, None]
    )
    yield from outside("pending.next_id", pending.next_id, 0)


def _of_graphs(state: TrackerState, now: int) -> Iterator[str]:
    company, distances = state.cooccurrence, state.distances
    yield from outside("cooccurrence.episodes", company.episodes, 0)
    yield from outside("cooccurrence.last_episode", company.last_episode, NEVER, max(now, NEVER))
    yield from outside("cooccurrence.pending_hits", company.pending_hits, 0)
    yield from outside("cooccurrence.count", company.count, 0)
    yield from outside("cooccurrence.weight", company.weight, 0)
    yield from outside("cooccurrence.edge_time", company.edge_time, NEVER, max(now, NEVER))
    yield from outside("distances.pending.kind", distances.pending.kind, 0, 2 * len(Contact) - 1)
    yield from outside("distances.pending.count", distances.pending.count, 0)
    yield from outside("distances.edges.contact_count", distances.edges.contact_count, 0)
    yield from outside("distances.edges.gap_count", distances.edges.gap_count, 0)
    yield from outside("distances.nearer", distances.nearer, 0)


def _of_bank(name: str, bank: Any, now: int) -> Iterator[str]:
    """Of one bank of every object and channel; its first `size` slots are in use."""
    num_slots = np.asarray(bank.embedding).shape[-2]
    size = np.asarray(bank.size)
    yield from outside(f"{name}.size", size, 0, num_slots)
    used = np.arange(num_slots) < size[..., None]
    yield from not_unit(f"{name}.embedding", bank.embedding, used)
    yield from outside(f"{name}.hits", bank.hits, 0, where=used)
    yield from outside(f"{name}.last_seen", bank.last_seen, NEVER, max(now, NEVER), used)
    yield from outside(f"{name}.quality_recent", bank.quality_recent, 0, 1, used)
    yield from outside(f"{name}.quality_sum", bank.quality_sum, 0, where=used)
    yield from outside(f"{name}.num_qualities", bank.num_qualities, 0, where=used)
