"""The tracker on one page: the pure step from one frame to the next, in its two halves."""

from __future__ import annotations

from typing import Any

from jaxtyping import Array, Bool

from remind_jax.decision import Decisions
from remind_jax.observation import FrameFeats, Masks, without_coverage
from remind_jax.remind.association.assignment import associate
from remind_jax.remind.association.diagnosis import diagnose, find_anchors
from remind_jax.remind.association.quality import Quality, assess
from remind_jax.remind.association.similarity import Comparison, compare, count_terms
from remind_jax.remind.context.evidence import view_frame
from remind_jax.remind.context.reasoning import Reasoning, reason
from remind_jax.remind.outcome import Intermediates
from remind_jax.remind.outcome import decide as decide_outcomes
from remind_jax.remind.perception.description import DescribedFrame, describe
from remind_jax.remind.perception.relations import Relations, observe_relations
from remind_jax.remind.remember import remember
from remind_jax.remind.state import TrackerState, init
from remind_jax.remind.thresholds import Thresholds
from remind_jax.remind.trace import Trace, collect_trace
from remind_jax.remind.undecided.settlement import settle
from remind_jax.remind.undecided.temporal import tabulate_pairs
from remind_jax.static import Static

__all__ = ["decide", "describe_frame", "init"]


def describe_frame(
    frame_feats: FrameFeats, masks: Masks, observed: Any, *, static: Static, thresholds: Thresholds
) -> DescribedFrame:
    """What does each detection look like? Nothing is observed beside them."""
    descriptors = describe(frame_feats, masks, static, thresholds.as_arrays(static.scalar))
    return DescribedFrame(descriptors, without_coverage(masks))


def decide(
    state: TrackerState, seen: DescribedFrame, *, static: Static, thresholds: Thresholds
) -> tuple[TrackerState, Trace]:
    """Decides who is who in one frame and remembers it.

    Returns:
      Memory after the frame with `decisions` about it, and what they were made of. If the frame
      needs more object slots than there are, only `overflow` is changed.
    """
    t = thresholds.as_arrays(static.scalar)
    # How good is each observation?
    quality = assess(seen.descriptors, t.similarity)
    relations = observe_relations(seen.masks, t.relations)
    # How similar is it to each object?
    comparison = compare(state, seen.descriptors, quality, static, t)
    candidate, score = comparison.candidate, comparison.score
    anchors = find_anchors(score, candidate, t.diagnosis)
    # Which tracks belong together here?
    view = view_frame(state, anchors, seen, t.cooccurrence)
    reasoning = reason(view, candidate, score, static, t)
    decisions, made_of = decide_pairs(
        state, seen, quality, relations, comparison, anchors, reasoning, static, t
    )
    after = remember(state, seen, decisions, made_of, static, t)
    return after, collect_trace(made_of, static, t)


def decide_pairs(
    state: TrackerState,
    seen: DescribedFrame,
    quality: Quality,
    relations: Relations,
    comparison: Comparison,
    anchors: Bool[Array, "N O"],
    reasoning: Reasoning,
    static: Static,
    t: Thresholds,
) -> tuple[Decisions, Intermediates]:
    """Decides by what was found about every pair; memory fills in the ids of what is new."""
    class_id = seen.descriptors.class_id
    num_terms, margin = count_terms(comparison), static.switches.margin
    evidence = diagnose(comparison.score, comparison.candidate, num_terms, margin, t.diagnosis)
    # Who is who, jointly?
    assignment = associate(comparison, evidence, reasoning, class_id, static, t)
    pairs = assignment.pairs
    # Who stays undecided?
    table = tabulate_pairs(comparison, pairs, reasoning, t)
    settlement = settle(table, assignment, state, seen.descriptors, relations, static)
    final = diagnose(pairs.score_final, pairs.eligible, num_terms, margin, t.diagnosis)
    decisions, stages = decide_outcomes(
        state.objects, seen, table, anchors, evidence, final, assignment, settlement, static
    )
    return decisions, Intermediates(
        state, quality, relations, anchors, table, assignment, settlement, stages
    )
