"""The paper's tracker under its name among the methods."""

from __future__ import annotations

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Int

from remind_jax.method import PAPER_METHOD, Host, Method, Needs, Sweeping
from remind_jax.remind.faults import find_faults
from remind_jax.remind.memory_need import count_bytes
from remind_jax.remind.state import TrackerState, count_occupied, grow, init, remove_objects
from remind_jax.remind.thresholds import Thresholds
from remind_jax.remind.tracker import decide, describe_frame
from remind_jax.static import Static


def remove(state: TrackerState, empty: TrackerState, ids: Int[np.ndarray, "ids"]) -> TrackerState:
    """The memory without some objects, and without their looks (host)."""
    return jax.jit(remove_objects)(state, jnp.isin(state.objects.id, ids))


def gap_options(thresholds: Thresholds) -> dict[str, float]:
    """How exactly gaps between masks are measured."""
    relations = thresholds.relations
    return {
        "scale_min_px": float(relations.scale_min_px),
        "exact_gap_max": float(relations.exact_gap_max),
    }


METHOD = Method(
    PAPER_METHOD,
    Thresholds,
    init,
    decide,
    describe_frame,
    Needs(
        wants_attention=lambda static: "attention" in static.part_channels, gap_options=gap_options
    ),
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
    static_fields=tuple(field.name for field in dataclasses.fields(Static)),
)
