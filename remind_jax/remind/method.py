"""The paper's tracker under its name among the methods."""

from __future__ import annotations

import operator
from collections.abc import Iterator
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Int

from remind_jax.method import PAPER_METHOD, Host, Method, Needs, Sweeping
from remind_jax.numerics.absent import NEVER, NO_ID
from remind_jax.numerics.array_faults import not_unit, outside
from remind_jax.remind.memory.objects import Lifecycle
from remind_jax.remind.memory.pending import Kind
from remind_jax.remind.perception.relations import Contact
from remind_jax.remind.state import BANKS, TrackerState, count_occupied, grow, init, remove_objects
from remind_jax.remind.switches import Switches
from remind_jax.remind.thresholds import Thresholds
from remind_jax.remind.tracker import decide, describe_frame
from remind_jax.static import Static


def find_faults(state: TrackerState) -> Iterator[str]:
    """Phrases about values that no run makes; leaves are host arrays of the right shapes."""
    now = int(state.frame) - 1  # the last frame that was seen
    yield from _of_objects(state, now)
    yield from _of_pending(state)
    yield from _of_graphs(state, now)
    for name in BANKS:
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
    pending, last_id = state.pending, max(int(state.next_id) - 1, NO_ID)
    used = np.asarray(pending.kind) != Kind.FREE
    yield from outside("pending.kind", pending.kind, Kind.FREE, max(Kind))
    for name in ("id", "hits", "area"):
        yield from outside(f"pending.{name}", getattr(pending, name), 0, where=used)
    yield from outside("pending.known_id", pending.known_id, NO_ID, last_id, used[:, None])
    yield from outside("pending.next_id", pending.next_id, 0)


def _of_graphs(state: TrackerState, now: int) -> Iterator[str]:
    company, distances = state.cooccurrence, state.distances
    for name in ("episodes", "pending_hits", "count", "weight"):
        yield from outside(f"cooccurrence.{name}", getattr(company, name), 0)
    for name in ("last_episode", "edge_time"):
        yield from outside(f"cooccurrence.{name}", getattr(company, name), NEVER, max(now, NEVER))
    yield from outside("distances.pending.kind", distances.pending.kind, 0, 2 * len(Contact) - 1)
    for name in ("pending.count", "edges.contact_count", "edges.gap_count", "nearer"):
        yield from outside(f"distances.{name}", operator.attrgetter(name)(distances), 0)


def _of_bank(name: str, bank: Any, now: int) -> Iterator[str]:
    """Of one bank of every object and channel; its first `size` slots are in use."""
    num_slots = np.asarray(bank.embedding).shape[-2]
    size = np.asarray(bank.size)
    yield from outside(f"{name}.size", size, 0, num_slots)
    used = np.arange(num_slots) < size[..., None]
    yield from not_unit(f"{name}.embedding", bank.embedding, used)
    yield from outside(f"{name}.last_seen", bank.last_seen, NEVER, max(now, NEVER), used)
    yield from outside(f"{name}.quality_recent", bank.quality_recent, 0, 1, used)
    for leaf in ("hits", "quality_sum", "num_qualities"):
        yield from outside(f"{name}.{leaf}", getattr(bank, leaf), 0, where=used)


# What a memory takes (docs/performance.md#crowds).
NUMBER = 4  # bytes
BESIDE = 20  # numbers that are kept of a prototype beside its embedding
TRIPLE_OF_OBJECTS = 2  # numbers: which of two objects is nearer to a third, and by how much
PAIR_OF_OBJECTS = 30  # numbers: distances and company
OF_PROTOTYPE_AND_DETECTION = 3  # numbers that are held at once to compare them
OF_DETECTION = 10_000  # numbers


def remove(state: TrackerState, empty: TrackerState, ids: Int[np.ndarray, "ids"]) -> TrackerState:
    """The memory without some objects, and without their looks (host)."""
    return jax.jit(remove_objects)(state, jnp.isin(state.objects.id, ids))


def attention_heads(static: Static) -> tuple[int, ...] | None:
    """Those that parts by attention come from, if there are any."""
    switches = static.switches
    return switches.attention_heads if "attention" in switches.part_channels else None


def gap_options(thresholds: Thresholds) -> dict[str, float]:
    """How exactly gaps between masks are measured."""
    relations = thresholds.relations
    return {
        "scale_min_px": float(relations.scale_min_px),
        "exact_gap_max": float(relations.exact_gap_max),
    }


def count_bytes(static: Static) -> int:
    """Bytes of the memory and of a step, estimated before anything is made; widths are known.

    Grows with the third power of the objects, and with objects times detections.
    """
    switches = static.switches
    objects, detections = static.num_objects, static.num_detections
    slots = objects + static.num_pending
    banks = [switches.appearance_slots] * 2 + [switches.part_slots] * len(switches.part_channels)
    banks += [switches.inner_ring_slots, switches.outer_ring_slots]
    if switches.ring_prototypes:
        banks += [switches.inner_prototype_slots, switches.outer_prototype_slots]
    prototypes = sum(work + stable for work, stable in banks)
    return NUMBER * (
        TRIPLE_OF_OBJECTS * objects**3
        + PAIR_OF_OBJECTS * objects**2
        + (static.feature_dim + BESIDE) * prototypes * slots
        + OF_PROTOTYPE_AND_DETECTION * prototypes * objects * detections
        + OF_DETECTION * detections
    )


# Arrays of memory files before schema 9, which held these leaves side by side.
_COLUMNS: dict[str, tuple[int, tuple[str, ...]]] = {
    f"{record}.{name}": (-1, tuple(f"{record}.{leaf}" for leaf in leaves.split()))
    for record, name, leaves in (
        ("objects", "wholes", "id class_id lifecycle hits misses age last_seen"),
        ("pending", "wholes", "kind class_id from_parent id hits known_id"),
        ("pending", "reals", "known_score center area"),
        ("distances.edges", "counts", "gap_count contact_count"),
        ("distances.edges", "means", "gap_mean center_mean support_mean"),
    )
}

METHOD = Method(
    PAPER_METHOD,
    Thresholds,
    init,
    decide,
    describe_frame,
    Needs(attention_heads=attention_heads, gap_options=gap_options),
    Host(
        grow=grow,
        occupied=count_occupied,
        explainer_name="remind_jax.explanation.remind.explainer:RemindExplainer",
        remove=remove,
        find_faults=find_faults,
        columns=_COLUMNS,
        count_bytes=count_bytes,
    ),
    Sweeping(
        described_by=("perception", "ring_prototypes", "attention_parts"),
        # Gaps are measured as exactly as any setting needs.
        reduced_by=("relations.scale_min_px", "relations.exact_gap_max"),
    ),
    switches=Switches,
)
