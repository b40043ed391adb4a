"""What a step knew when it decided: the numbers behind every decision of one frame.

`tracker.decide` gives them beside the memory; what nobody reads is not computed. On the host the
same classes hold NumPy arrays without padding (`explanation.remind`).

Letters: `N` detections, `C` candidates shown, `T` terms (object, background, parts; with them on,
ring prototypes), `R` passes of the reconciliation, `K = 3` objects that an undecided detection may
name, `A` anchors of a closed group, `H` sets of objects, `O` object slots.
"""

from __future__ import annotations

import dataclasses

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from remind_jax.numerics.absent import NO_ID
from remind_jax.observation import Descriptors
from remind_jax.remind.association.assignment import Assignment, dummy_scores
from remind_jax.remind.association.diagnosis import Evidence, top_two
from remind_jax.remind.association.quality import Quality
from remind_jax.remind.association.similarity import term_weights
from remind_jax.remind.context.evidence import FrameView
from remind_jax.remind.context.hypotheses import Hypotheses
from remind_jax.remind.context.reasoning import Reasoning
from remind_jax.remind.context.veto import expect_neighbors, plausibly_in_view
from remind_jax.remind.disambiguation.distance_evidence import (
    tabulate_edges,
)
from remind_jax.remind.disambiguation.joint_assignments import NUMBERS
from remind_jax.remind.outcome import named_ids
from remind_jax.remind.perception.relations import Relations
from remind_jax.remind.stages import Stages
from remind_jax.remind.state import TrackerState
from remind_jax.remind.thresholds import Thresholds
from remind_jax.remind.undecided.settlement import Settlement
from remind_jax.remind.undecided.temporal import PairTable, temporal_score
from remind_jax.static import Static


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class CandidateTrace:
    """Known objects that a detection was compared with, by falling visual score.

    Those that some rule named are among them, then the visually best.
    """

    id: Int[Array, "N C"]  # -1 padding
    lifecycle: Int[Array, "N C"]  # state.Lifecycle before the frame
    unseen_frames: Int[Array, "N C"]  # frames unseen before the frame
    value: Float[Array, "N C T"]  # score of each term
    present: Bool[Array, "N C T"]
    weight: Float[Array, "N C T"]  # after the quality of observation and prototype
    authority: Float[Array, "N C"]  # how proven the prototype is that won, [0, 1]
    visual_score: Float[Array, "N C"]  # weighted mean of the terms
    comparable_score: Float[
        Array, "N C"
    ]  # on the evidence that all plausible ones have, with context
    bonus_raw: Float[Array, "N C"]  # what context would add
    bonus: Float[Array, "N C"]  # what it was allowed to add
    assignment_score: Float[Array, "N C"]  # what the joint assignment maximized
    final_score: Float[Array, "N C"]  # what was tested for acceptance
    known: Float[Array, "N C"]  # the same with context even where it may not influence
    eligible: Bool[Array, "N C"]  # open to assignment
    plausible: Bool[Array, "N C"]  # not vetoed
    gate: Int[Array, "N C"]  # association.gating.Gate
    veto: Int[Array, "N C"]  # context.veto.Veto
    backed: Bool[Array, "N C"]  # clearly backed by context
    support: Float[Array, "N C"]  # by context, [0, 1]
    contradiction: Float[Array, "N C"]  # by context, [0, 1]
    relative_support: Float[Array, "N C"]  # against the best of the class, [0, 1]
    num_expected: Int[Array, "N C"]  # neighbors that it leads one to expect
    num_expected_seen: Int[Array, "N C"]  # of these, plausibly in view elsewhere in the frame


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class PassTrace:
    """Each pass of the reconciliation: who was undecided, and what the layout decided."""

    undecided: Bool[Array, "N R"]  # when the pass began
    reason: Int[Array, "N R"]  # decision.Reason
    option_id: Int[Array, "N R K"]  # objects in question, -1 padding
    option_score: Float[Array, "N R K"]
    root: Int[Array, "N R"]  # first detection of its closed group, -1 outside groups
    status: Int[Array, "N R"]  # disambiguation.joint_assignments.GroupStatus
    num_objects: Int[Array, "N R"]  # that the group names, those not yet founded included
    proposed_id: Int[Array, "N R"]  # object in the best assignment of the group, -1 if not scored
    score: Float[Array, "N R"]  # of that assignment
    second: Float[Array, "N R"]  # of the runner-up, -1 without any
    core: Float[Array, "N R"]  # score without appearance
    core_gap: Float[Array, "N R"]
    evidence: Float[Array, "N R"]  # summed weight of the anchors
    anchor_id: Int[Array, "N R A"]  # objects whose distances voted, -1 padding
    anchor_detection: Int[Array, "N R A"]  # where they are in this frame
    anchor_quality: Float[Array, "N R A"]  # how well each separates the group
    distance: Float[Array, "N R A"]  # from the detection to the anchor now, in object sizes
    remembered: Float[Array, "N R K A"]  # from each object in question, mean of past episodes
    num_remembered: Int[Array, "N R K A"]  # episodes; 0: never seen together


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class DetectionTrace:
    """What was known about each detection besides its `Decisions`."""

    quality: Float[Array, "N 3"]  # of object, background and parts, [0, 1]
    density: Float[Array, "N 2"]  # factor for thin masks on object and parts, [0, 1]
    patch_sum: Float[Array, "N"]  # summed coverage in patches
    source: Int[Array, "N T"]  # banks compared with: similarity.AUTO, WORK, STABLE
    num_candidates: Int[Array, "N"]  # all objects of its class
    num_backed: Int[Array, "N"]  # of these, plausible and clearly backed by context
    backed_id: Int[Array, "N"]  # the best of these on common evidence, -1 none
    backed_score: Float[Array, "N"]  # its comparable score
    anchor_id: Int[Array, "N"]  # object that it is an anchor for, -1 none
    dummy: Float[Array, "N"]  # score of staying without an object in the joint assignment
    rival: Int[Array, "N"]  # other detection most like the same object, -1 none
    rival_score: Float[Array, "N"]  # its visual score
    group: Int[Array, "N"]  # first detection of its group of look-alikes, -1 none
    group_gap: Float[Array, "N"]  # lead of the best joint assignment of the group; -1: only one
    reserved_id: Int[Array, "N"]  # object that it founds although undecided, -1 none
    kept_count: Int[Array, "N"]  # objects of its class that context supports
    candidates: CandidateTrace
    passes: PassTrace


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class SetTrace:
    """Sets of objects that may be in view together, the most believable first."""

    score: Float[Array, "H"]  # [0, 1]
    member_id: Int[Array, "H M"]  # ascending, -1 padding
    detections: Bool[Array, "H N"]  # that the members explain
    coverage: Float[Array, "H"]  # [0, 1]
    density: Float[Array, "H"]  # [0, 1]
    maturity: Float[Array, "H"]  # [0, 1)
    valid: Bool[Array, "H"]


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class ContextTrace:
    """The context of the frame as a whole."""

    enabled: Bool[Array, ""]
    quality: Float[Array, ""]  # [0, 1]
    usable: Bool[Array, ""]  # good enough to reward and to punish


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Trace:
    """What the decisions of one frame were made of."""

    stages: Stages
    detections: DetectionTrace
    sets: SetTrace
    context: ContextTrace


@dataclasses.dataclass(frozen=True)
class Intermediates:
    """Intermediate results of one step, as they arise."""

    state: TrackerState  # before the frame
    descriptors: Descriptors
    quality: Quality
    relations: Relations
    evidence: Evidence
    anchors: Bool[Array, "N O"]
    view: FrameView
    reasoning: Reasoning
    table: PairTable
    assignment: Assignment
    settlement: Settlement
    visual_gate: Float[Array, ""]
    stages: Stages


def collect_trace(intermediates: Intermediates, static: Static, t: Thresholds) -> Trace:
    """Picks what explains the decisions of a frame.

    Args:
      intermediates: Intermediate results of the step.
      static: Number of candidates shown.
      t: Thresholds as arrays.
    """
    d, influence = intermediates, intermediates.reasoning.influence
    return Trace(
        stages=d.stages,
        detections=_trace_detections(d, static, t),
        sets=_trace_sets(d.reasoning.hypotheses, d.state.objects.id),
        context=ContextTrace(influence.enabled, influence.quality, influence.global_ok),
    )


def _trace_detections(d: Intermediates, static: Static, t: Thresholds) -> DetectionTrace:
    comparison, objects = d.table.comparison, d.state.objects
    influence, q = d.reasoning.influence, d.quality
    num = comparison.candidate.shape[0]
    seen = plausibly_in_view(comparison.candidate, comparison.score, d.visual_gate)
    rows = _choose_candidates(d, static)
    is_anchor = jnp.any(d.anchors, axis=1)
    anchor = objects.id[jnp.argmax(d.anchors, axis=1)]
    rival, rival_score = _find_rivals(d)
    stable = d.settlement.stabilized
    member = jnp.argmax(comparison.candidate, axis=1)  # any object of the class
    some = jnp.any(comparison.candidate, axis=1)
    comparable = temporal_score(d.table, d.table.plausible)
    backed = d.table.plausible & d.table.context.supported[None]
    num_backed = jnp.sum(backed, axis=1, dtype=jnp.int32)
    first, backed_score, _ = top_two(comparable, backed)
    return DetectionTrace(
        quality=jnp.stack([q.object, q.background, q.parts], axis=1),
        density=jnp.stack([q.object_density, q.parts_density], axis=1),
        patch_sum=d.descriptors.patch_sum,
        source=comparison.source.T,
        num_candidates=jnp.sum(comparison.candidate, axis=1, dtype=jnp.int32),
        num_backed=num_backed,
        backed_id=jnp.where(num_backed > 0, objects.id[first], NO_ID),
        backed_score=backed_score,
        anchor_id=jnp.where(is_anchor, anchor, NO_ID),
        dummy=dummy_scores(d.evidence, t.matching),
        rival=rival,
        rival_score=rival_score,
        group=jnp.where(stable.root < num, stable.root, -1),
        group_gap=jnp.where(jnp.isfinite(stable.gap), stable.gap, -1.0),
        reserved_id=d.settlement.reserved_id,
        kept_count=jnp.where(some, influence.kept_count[member], 0),
        candidates=_trace_candidates(d, rows, seen, comparable, static, t),
        passes=_trace_passes(d, t),
    )


def _choose_candidates(d: Intermediates, static: Static) -> Int[Array, "N C"]:
    """Slots of the candidates to show: those named by a rule, then the visually best."""
    comparison, s = d.table.comparison, d.settlement
    num, width = comparison.candidate.shape
    asked = jnp.moveaxis(s.rounds.entries.slot, 0, 1).reshape(num, -1)
    single = jnp.stack([d.assignment.slot, s.guarded, s.slot], axis=1)
    named = jnp.concatenate([single, asked, s.ambiguous.slot, s.doubts.support], axis=1)
    is_named = jnp.any(named[:, :, None] == jnp.arange(width), axis=1)
    shown = min(static.num_candidates, width)

    def best(counted: Bool[Array, "N O"], score: Float[Array, "N O"]) -> tuple[Array, Array]:
        top, slots = jax.lax.top_k(jnp.where(counted, score, -jnp.inf), shown)
        return slots, jnp.isfinite(top)

    slots, real = best(comparison.candidate, comparison.score + 2.0 * is_named)
    chosen = jnp.any((slots[:, :, None] == jnp.arange(width)) & real[..., None], axis=1)
    slots, real = best(chosen, comparison.score)
    slots = jnp.where(real, slots, -1).astype(jnp.int32)
    return jnp.pad(slots, ((0, 0), (0, static.num_candidates - shown)), constant_values=-1)


def _trace_candidates(
    d: Intermediates,
    rows: Int[Array, "N C"],
    seen: Bool[Array, "N O"],
    comparable: Float[Array, "N O"],
    static: Static,
    t: Thresholds,
) -> CandidateTrace:
    comparison, pairs, influence = d.table.comparison, d.assignment.pairs, d.reasoning.influence
    shape, at = comparison.candidate.shape, jnp.maximum(rows, 0)
    expected = expect_neighbors(d.view, t.sets.min_link, static, t.veto)
    common = seen.astype(jnp.float32) @ expected.T.astype(jnp.float32)

    def take(values: Array) -> Array:
        """The shown columns of a table `[N O]`, `[O]` or `[T N O]`."""
        if values.ndim == 3:
            return jax.vmap(take, out_axes=2)(values)
        table = jnp.broadcast_to(values, shape)
        picked = jnp.take_along_axis(table, at, axis=1)
        return jnp.where(rows >= 0, picked, jnp.zeros((), picked.dtype))

    terms = comparison.terms
    return CandidateTrace(
        id=jnp.where(rows >= 0, d.state.objects.id[at], NO_ID),
        lifecycle=take(d.state.objects.lifecycle),
        unseen_frames=take(d.state.objects.misses),
        value=take(terms.value),
        present=take(terms.present),
        weight=take(
            jnp.broadcast_to(
                term_weights(d.quality, terms.authority, t.similarity, len(terms.value)),
                terms.value.shape,
            )
        ),
        authority=take(terms.authority),
        visual_score=take(comparison.score),
        comparable_score=take(comparable),
        bonus_raw=take(influence.bonus_raw),
        bonus=take(pairs.bonus),
        assignment_score=take(pairs.score_assign),
        final_score=take(pairs.score_final),
        known=take(pairs.score_known),
        eligible=take(pairs.eligible),
        plausible=take(d.table.plausible),
        gate=take(pairs.gate),
        veto=take(d.reasoning.veto),
        backed=take(d.table.context.supported),
        support=take(influence.support),
        contradiction=take(influence.contradiction),
        relative_support=take(influence.compat_rel),
        num_expected=take(jnp.sum(expected, axis=1, dtype=jnp.int32)),
        num_expected_seen=take(common.astype(jnp.int32)),
    )


def _find_rivals(d: Intermediates) -> tuple[Int[Array, "N"], Float[Array, "N"]]:
    """The other plausible detection most like the object assigned, or like the best candidate."""
    comparison = d.table.comparison
    best = jnp.argmax(jnp.where(comparison.candidate, comparison.score, -jnp.inf), axis=1)
    slot = jnp.where(d.assignment.slot >= 0, d.assignment.slot, best)
    num = slot.shape[0]
    others = d.table.plausible[:, slot].T & ~jnp.eye(num, dtype=bool)
    others = others & jnp.any(comparison.candidate, axis=1)[:, None]
    score = jnp.where(others, comparison.score[:, slot].T, -jnp.inf)
    some = jnp.any(others, axis=1)
    rival = jnp.where(some, jnp.argmax(score, axis=1), -1).astype(jnp.int32)
    return rival, jnp.where(some, jnp.max(score, axis=1), 0.0)


def _trace_passes(d: Intermediates, t: Thresholds) -> PassTrace:
    s = d.settlement
    width, num = d.state.objects.id.shape[0], s.slot.shape[0]
    rounds, groups = s.rounds, s.groups
    edges = d.state.distances.edges
    table = tabulate_edges(edges, t.known_sets)
    now = d.relations.distance

    def name(slot: Array) -> Array:
        return named_ids(d.state.objects, slot, s.reserved_id)

    in_group = rounds.root >= 0  # [R N]
    at = jnp.maximum(rounds.root, 0)

    def of_group(leaf: Array, absent: int = 0) -> Array:
        index = at.reshape(*at.shape, *(1,) * (leaf.ndim - 2))
        inside = in_group.reshape(index.shape)
        return jnp.where(inside, jnp.take_along_axis(leaf, index, axis=1), absent)

    anchor, place = of_group(groups.anchor, -1), of_group(groups.anchor_place, -1)
    option = jnp.where(rounds.entries.present[..., None], rounds.entries.slot, -1)
    source = jnp.clip(option, 0, width - 1)[..., None]
    target = jnp.maximum(anchor, 0)[:, :, None]
    known = (option >= 0) & (option < width)
    known = known[..., None] & (anchor >= 0)[:, :, None]
    numbers = jnp.moveaxis(of_group(groups.numbers), -1, 0)
    number = dict(zip(NUMBERS, numbers, strict=True))
    far = now[jnp.arange(num)[None, :, None], jnp.maximum(place, 0)]
    by_pass = PassTrace(
        undecided=rounds.entries.present,
        reason=jnp.where(rounds.entries.present, rounds.entries.reason, 0),
        option_id=name(option),
        option_score=jnp.where(option >= 0, rounds.entries.score, 0.0),
        root=rounds.root,
        status=of_group(groups.status),
        num_objects=of_group(groups.num_candidates),
        proposed_id=name(rounds.proposed),
        score=number["score"],
        second=number["second"],
        core=number["core"],
        core_gap=number["core_gap"],
        evidence=number["evidence"],
        anchor_id=name(anchor),
        anchor_detection=place,
        anchor_quality=of_group(groups.anchor_quality),
        distance=jnp.where(anchor >= 0, far, 0.0),
        remembered=jnp.where(known, table[source, target, 2], 0.0),
        num_remembered=jnp.where(known, edges.count[source, target], 0),
    )
    return jax.tree.map(lambda leaf: jnp.moveaxis(leaf, 0, 1), by_pass)


def _trace_sets(hypotheses: Hypotheses, ids: Int[Array, "O"]) -> SetTrace:
    h = hypotheses
    none = jnp.iinfo(jnp.int32).max
    # A set explains as many detections as it has members.
    most = min(h.detections.shape[1], ids.shape[0])
    members = jnp.sort(jnp.where(h.members, ids, none), axis=1)[:, :most]
    return SetTrace(
        score=h.score,
        member_id=jnp.where(members == none, NO_ID, members),
        detections=h.detections,
        coverage=h.coverage,
        density=h.density,
        maturity=h.maturity,
        valid=h.valid,
    )
