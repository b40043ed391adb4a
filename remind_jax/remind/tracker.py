"""The tracker on one page: `init` and the pure `step` from one frame to the next.

`step_described` is the same step for detections that were described before; `step_traced` and
`step_described_traced` trace its decisions.
"""

from __future__ import annotations

import jax.numpy as jnp

from remind_jax.decision import Outcome
from remind_jax.errors import ConfigError
from remind_jax.observation import Descriptors, FrameFeats, Masks
from remind_jax.remind.association.assignment import associate
from remind_jax.remind.association.diagnosis import diagnose, find_anchors
from remind_jax.remind.association.gating import read_context
from remind_jax.remind.association.quality import assess
from remind_jax.remind.association.similarity import compare, count_terms
from remind_jax.remind.context.evidence import view_frame
from remind_jax.remind.context.reasoning import reason
from remind_jax.remind.outcome import decide
from remind_jax.remind.perception.description import describe
from remind_jax.remind.perception.relations import observe_relations
from remind_jax.remind.remember import remember
from remind_jax.remind.state import TrackerState, init
from remind_jax.remind.thresholds import Thresholds
from remind_jax.remind.trace import Intermediates, Trace, collect_trace
from remind_jax.remind.undecided.provisional_commit import support_births
from remind_jax.remind.undecided.settlement import settle
from remind_jax.remind.undecided.temporal import tabulate_pairs
from remind_jax.static import Static

__all__ = ["init", "step", "step_described", "step_described_traced", "step_traced"]


def step(
    state: TrackerState,
    frame_feats: FrameFeats,
    masks: Masks,
    *,
    static: Static,
    thresholds: Thresholds,
) -> TrackerState:
    """Decides who is who in one frame and remembers it.

    Pure: `jit` (with `static` static), `vmap` and `scan` apply unchanged.

    Args:
      state: Memory before the frame, from `init` or an earlier step.
      frame_feats: Patch features of the frame.
      masks: Its detections.
      static: Capacities and structural switches; those that `state` was made with.
      thresholds: Every tunable number.

    Returns:
      Memory after the frame with `decisions` about it. If the frame needs more object slots than
      there are, only `overflow` is changed.

    Raises:
      ConfigError: If `static` or `thresholds` are of another kind.
    """
    for name, given, kind in (("static", static, Static), ("thresholds", thresholds, Thresholds)):
        if not isinstance(given, kind):
            raise ConfigError(
                f"{name} are of type {type(given).__name__}; give remind_jax.{kind.__name__}"
            )
    # What does each detection look like?
    t = thresholds.as_arrays(static.scalar)
    return _advance(state, describe(frame_feats, masks, static, t), masks, static, t)[0]


def step_described(
    state: TrackerState,
    descriptors: Descriptors,
    masks: Masks,
    *,
    static: Static,
    thresholds: Thresholds,
) -> TrackerState:
    """As `step` for detections that `describe` has seen already; patch coverage is not read."""
    return _advance(state, descriptors, masks, static, thresholds.as_arrays(static.scalar))[0]


def step_traced(
    state: TrackerState,
    frame_feats: FrameFeats,
    masks: Masks,
    *,
    static: Static,
    thresholds: Thresholds,
) -> tuple[TrackerState, Trace]:
    """As `step`, with the trace of every decision."""
    t = thresholds.as_arrays(static.scalar)
    descriptors = describe(frame_feats, masks, static, t)
    return step_described_traced(state, descriptors, masks, static=static, thresholds=thresholds)


def step_described_traced(
    state: TrackerState,
    descriptors: Descriptors,
    masks: Masks,
    *,
    static: Static,
    thresholds: Thresholds,
) -> tuple[TrackerState, Trace]:
    """As `step_described`, with the trace of every decision."""
    t = thresholds.as_arrays(static.scalar)
    after, intermediates = _advance(state, descriptors, masks, static, t)
    return after, collect_trace(intermediates, static, t)


def _advance(
    state: TrackerState,
    descriptors: Descriptors,
    masks: Masks,
    static: Static,
    t: Thresholds,
) -> tuple[TrackerState, Intermediates]:
    """The chain of one frame; what nobody asks for is never computed."""
    # How good is each observation?
    quality = assess(descriptors, t.similarity)
    relations = observe_relations(masks, masks.relations, t.relations)
    # How similar is it to each object?
    comparison = compare(
        state, descriptors, quality, static, t.similarity,
        t.background.enabled, t.appearance.promote_hits,
    )  # fmt: skip
    num_terms = count_terms(comparison)
    evidence = diagnose(
        comparison.score, comparison.candidate, num_terms, static.margin, t.diagnosis
    )
    anchors = find_anchors(comparison.score, comparison.candidate, t.diagnosis)
    # Which tracks belong together here?
    view = view_frame(
        state.cooccurrence, state.objects, jnp.any(anchors, axis=0), descriptors, masks,
        t.cooccurrence,
    )  # fmt: skip
    visual_gate = jnp.maximum(t.matching.match, t.matching.min_visual)
    reasoning = reason(
        view, comparison.candidate, comparison.score, visual_gate, static, t.sets, t.influence,
        t.veto,
    )  # fmt: skip
    context = read_context(reasoning, t.influence, t.ambiguous)
    # Who is who, jointly?
    assignment = associate(comparison, evidence, context, descriptors.class_id, static, t.matching)
    pairs = assignment.pairs
    # Who stays undecided?
    table = tabulate_pairs(comparison, pairs, context, t.similarity, t.ambiguous.known_set_score)
    settlement = settle(table, assignment, state, descriptors, relations, static, t)
    final = diagnose(pairs.score_final, pairs.eligible, num_terms, static.margin, t.diagnosis)
    decisions = decide(
        state.objects, masks, descriptors, table, anchors, evidence, final, assignment,
        settlement, static,
    )  # fmt: skip
    birth_support = support_births(
        pairs.score_known, table.plausible, state.objects, descriptors.class_id,
        decisions.outcome == Outcome.NEW,
    )  # fmt: skip
    after = remember(
        state, decisions, settlement, birth_support, comparison.pending_score, descriptors, masks,
        relations, static, t,
    )  # fmt: skip
    return after, Intermediates(
        state, descriptors, quality, relations, evidence, anchors, view,
        reasoning, table, assignment, settlement, visual_gate,
    )  # fmt: skip
