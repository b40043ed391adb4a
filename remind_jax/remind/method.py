"""The paper's tracker under its name among the methods, and its step in two halves."""

from __future__ import annotations

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Int

from remind_jax.method import PAPER_METHOD, Method, StepHalves
from remind_jax.observation import Descriptors, FrameFeats, Masks
from remind_jax.remind.faults import find_faults
from remind_jax.remind.memory_need import count_bytes
from remind_jax.remind.perception.description import describe
from remind_jax.remind.state import TrackerState, count_occupied, grow, init, remove_objects
from remind_jax.remind.thresholds import Thresholds
from remind_jax.remind.trace import Trace
from remind_jax.remind.tracker import step, step_described, step_described_traced, step_traced
from remind_jax.static import Static


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class DescribedFrame:
    """What `tracker.step_described` is given."""

    descriptors: Descriptors
    masks: Masks  # without patch coverage, which nothing reads after the description


def describe_frame(
    frame_feats: FrameFeats, masks: Masks, observed: Any, *, static: Static, thresholds: Thresholds
) -> DescribedFrame:
    """Describes every detection; nothing is observed beside them."""
    descriptors = describe(frame_feats, masks, static, thresholds.as_arrays(static.scalar))
    nothing = jnp.zeros((static.num_detections, 0, 0), jnp.float32)
    return DescribedFrame(
        descriptors, dataclasses.replace(masks, coverage=nothing, filled_coverage=nothing)
    )


def decide_described(
    state: TrackerState, seen: DescribedFrame, *, static: Static, thresholds: Thresholds
) -> TrackerState:
    """Decides who is who and remembers it."""
    return step_described(state, seen.descriptors, seen.masks, static=static, thresholds=thresholds)


def decide_described_traced(
    state: TrackerState, seen: DescribedFrame, *, static: Static, thresholds: Thresholds
) -> tuple[TrackerState, Trace]:
    """As `decide_described`, with the trace of every decision."""
    return step_described_traced(
        state, seen.descriptors, seen.masks, static=static, thresholds=thresholds
    )


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
    step,
    grow,
    count_occupied,
    step_traced,
    wants_attention=lambda static: "attention" in static.part_channels,
    gap_options=gap_options,
    remove=remove,
    find_faults=find_faults,
    static_fields=tuple(field.name for field in dataclasses.fields(Static)),
    explainer_name="remind_jax.explanation.remind.explainer:RemindExplainer",
    halves=StepHalves(
        describe_frame,
        decide_described,
        decide_described_traced,
        described_by=("perception", "ring_prototypes", "attention_parts"),
        # Gaps are measured as exactly as any setting needs.
        reduced_by=("relations.scale_min_px", "relations.exact_gap_max"),
    ),
    count_bytes=count_bytes,
)
