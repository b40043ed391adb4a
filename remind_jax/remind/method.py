"""The paper's tracker under its name among the methods."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Int

from remind_jax.method import PAPER_METHOD, Host, Method, Needs, Sweeping
from remind_jax.remind.faults import find_faults
from remind_jax.remind.state import TrackerState, count_occupied, grow, init, remove_objects
from remind_jax.remind.switches import Switches
from remind_jax.remind.thresholds import Thresholds
from remind_jax.remind.tracker import decide, describe_frame
from remind_jax.static import Static

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
        count_bytes=count_bytes,
    ),
    Sweeping(
        described_by=("perception", "ring_prototypes", "attention_parts"),
        # Gaps are measured as exactly as any setting needs.
        reduced_by=("relations.scale_min_px", "relations.exact_gap_max"),
    ),
    switches=Switches,
)
