"""What a step knew when it decided: the numbers behind every decision of one frame.

`tracker.decide` gives them beside the memory; what nobody reads is not computed. On the host the
same classes hold NumPy arrays without padding (`explanation.remind`).

Letters: `N` detections, `C` candidates shown, `T` terms (object, background, parts; with them on,
ring prototypes), `R` passes of the reconciliation, `K = 3` objects that an undecided detection may
name, `A` anchors of a closed group, `H` sets of objects, `O` object slots.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from remind_jax.numerics.absent import NO_ID
from remind_jax.numerics.pytree import pytree
from remind_jax.numerics.ranks import pick_best
from remind_jax.remind.association.similarity import term_weights
from remind_jax.remind.context.hypotheses import Hypotheses
from remind_jax.remind.disambiguation.distance_evidence import tabulate_edges
from remind_jax.remind.disambiguation.joint_assignments import NUMBERS
from remind_jax.remind.outcome import Intermediates, named_ids
from remind_jax.remind.stages import Stages
from remind_jax.remind.thresholds import Thresholds
from remind_jax.remind.undecided.temporal import temporal_score, to_mask
from remind_jax.static import Static


@pytree
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
    visual_score: Float[Array, "N C"]  # weighted mean of the terms
    comparable_score: Float[Array, "N C"]  # on the evidence that all plausible ones have
    bonus_raw: Float[Array, "N C"]  # what context would add
    bonus: Float[Array, "N C"]  # what it was allowed to add
    assignment_score: Float[Array, "N C"]  # what the joint assignment maximized
    final_score: Float[Array, "N C"]  # what was tested for acceptance
    plausible: Bool[Array, "N C"]  # not vetoed
    gate: Int[Array, "N C"]  # association.gating.Gate
    veto: Int[Array, "N C"]  # context.veto.Veto
    backed: Bool[Array, "N C"]  # clearly backed by context


@pytree
class PassTrace:
    """Each pass of the reconciliation: who was undecided, and what the layout decided."""

    undecided: Bool[Array, "N R"]  # when the pass began
    reason: Int[Array, "N R"]  # decision.Reason
    option_id: Int[Array, "N R K"]  # objects in question, -1 padding
    option_score: Float[Array, "N R K"]
    root: Int[Array, "N R"]  # first detection of its closed group, -1 outside groups
    status: Int[Array, "N R"]  # disambiguation.joint_assignments.GroupStatus
    proposed_id: Int[Array, "N R"]  # object in the best assignment of the group, -1 if not scored
    score: Float[Array, "N R"]  # of that assignment
    second: Float[Array, "N R"]  # of the runner-up, -1 without any
    core_gap: Float[Array, "N R"]
    evidence: Float[Array, "N R"]  # summed weight of the anchors
    anchor_id: Int[Array, "N R A"]  # objects whose distances voted, -1 padding
    anchor_detection: Int[Array, "N R A"]  # where they are in this frame
    distance: Float[Array, "N R A"]  # from the detection to the anchor now, in object sizes
    remembered: Float[Array, "N R K A"]  # from each object in question, mean of past episodes
    num_remembered: Int[Array, "N R K A"]  # episodes; 0: never seen together


@pytree
class DetectionTrace:
    """What was known about each detection besides its `Decisions`."""

    num_candidates: Int[Array, "N"]  # all objects of its class
    anchor_id: Int[Array, "N"]  # object that it is an anchor for, -1 none
    group: Int[Array, "N"]  # first detection of its group of look-alikes, -1 none
    candidates: CandidateTrace
    passes: PassTrace


@pytree
class SetTrace:
    """Sets of objects that may be in view together, the most believable first."""

    score: Float[Array, "H"]  # [0, 1]
    member_id: Int[Array, "H M"]  # ascending, -1 padding
    detections: Bool[Array, "H N"]  # that the members explain
    coverage: Float[Array, "H"]  # [0, 1]
    valid: Bool[Array, "H"]


@pytree
class ContextTrace:
    """The context of the frame as a whole."""

    enabled: Bool[Array, ""]
    quality: Float[Array, ""]  # [0, 1]
    usable: Bool[Array, ""]  # good enough to reward and to punish


@pytree
class Trace:
    """What the decisions of one frame were made of."""

    stages: Stages
    detections: DetectionTrace
    sets: SetTrace
    context: ContextTrace


def collect_trace(intermediates: Intermediates, static: Static, t: Thresholds) -> Trace:
    """Picks what explains the decisions of a frame."""
    d, reasoning = intermediates, intermediates.table.reasoning
    influence = reasoning.influence
    return Trace(
        stages=d.stages,
        detections=_trace_detections(d, static, t),
        sets=_trace_sets(reasoning.hypotheses, d.state.objects.id),
        context=ContextTrace(influence.enabled, influence.quality, influence.global_ok),
    )


def _trace_detections(d: Intermediates, static: Static, t: Thresholds) -> DetectionTrace:
    comparison, objects = d.table.comparison, d.state.objects
    num = comparison.candidate.shape[0]
    anchor = objects.id[jnp.argmax(d.anchors, axis=1)]
    root = d.settlement.stabilized.root
    return DetectionTrace(
        num_candidates=jnp.sum(comparison.candidate, axis=1, dtype=jnp.int32),
        anchor_id=jnp.where(jnp.any(d.anchors, axis=1), anchor, NO_ID),
        group=jnp.where(root < num, root, -1),
        candidates=_trace_candidates(d, static, t),
        passes=_trace_passes(d, t),
    )


def _choose_candidates(d: Intermediates, static: Static) -> Int[Array, "N C"]:
    """Slots of the candidates to show: those named by a rule, then the visually best."""
    comparison, s = d.table.comparison, d.settlement
    num, width = comparison.candidate.shape
    asked = jnp.moveaxis(s.asked.slot, 0, 1).reshape(num, -1)
    single = jnp.stack([d.assignment.slot, s.stabilized.slot, s.slot], axis=1)
    named = jnp.concatenate([single, asked, s.ambiguous.slot, s.doubts.support], axis=1)
    first = comparison.score + 2.0 * to_mask(named, width)
    chosen, _ = pick_best(first, comparison.candidate, static.num_candidates)
    return pick_best(comparison.score, to_mask(chosen, width), static.num_candidates)[0]


def _trace_candidates(d: Intermediates, static: Static, t: Thresholds) -> CandidateTrace:
    comparison, pairs, rows = d.table.comparison, d.assignment.pairs, _choose_candidates(d, static)
    shape, at = comparison.candidate.shape, jnp.maximum(rows, 0)

    def take(values: Array) -> Array:
        """The shown columns of a table `[N O]`, `[O]` or `[T N O]`."""
        if values.ndim == 3:
            return jax.vmap(take, out_axes=2)(values)
        table = jnp.broadcast_to(values, shape)
        picked = jnp.take_along_axis(table, at, axis=1)
        return jnp.where(rows >= 0, picked, jnp.zeros((), picked.dtype))

    terms = comparison.terms
    weights = term_weights(d.quality, terms.authority, t.similarity, len(terms.value))
    return CandidateTrace(
        id=jnp.where(rows >= 0, d.state.objects.id[at], NO_ID),
        lifecycle=take(d.state.objects.lifecycle),
        unseen_frames=take(d.state.objects.misses),
        value=take(terms.value),
        present=take(terms.present),
        weight=take(jnp.broadcast_to(weights, terms.value.shape)),
        visual_score=take(comparison.score),
        comparable_score=take(temporal_score(d.table, d.table.plausible)),
        bonus_raw=take(d.table.reasoning.influence.bonus_raw),
        bonus=take(pairs.bonus),
        assignment_score=take(pairs.score_assign),
        final_score=take(pairs.score_final),
        plausible=take(d.table.plausible),
        gate=take(pairs.gate),
        veto=take(d.table.reasoning.veto),
        backed=take(d.table.reasoning.supported),
    )


def _trace_passes(d: Intermediates, t: Thresholds) -> PassTrace:
    s = d.settlement
    width, num = d.state.objects.id.shape[0], s.slot.shape[0]
    asked, answers, groups = s.asked, s.answers, s.answers.groups
    edges = d.state.distances.edges
    table = tabulate_edges(edges, t.known_sets)
    now = d.relations.distance

    def name(slot: Array) -> Array:
        return named_ids(d.state.objects, slot, s.reserved_id)

    in_group = answers.root >= 0  # [R N]
    at = jnp.maximum(answers.root, 0)

    def of_group(leaf: Array, absent: int = 0) -> Array:
        index = at.reshape(*at.shape, *(1,) * (leaf.ndim - 2))
        inside = in_group.reshape(index.shape)
        return jnp.where(inside, jnp.take_along_axis(leaf, index, axis=1), absent)

    anchor, place = of_group(groups.anchor, -1), of_group(groups.anchor_place, -1)
    option = jnp.where(asked.present[..., None], asked.slot, -1)
    source = jnp.clip(option, 0, width - 1)[..., None]
    target = jnp.maximum(anchor, 0)[:, :, None]
    known = (option >= 0) & (option < width)
    known = known[..., None] & (anchor >= 0)[:, :, None]
    numbers = jnp.moveaxis(of_group(groups.numbers), -1, 0)
    number = dict(zip(NUMBERS, numbers, strict=True))
    far = now[jnp.arange(num)[None, :, None], jnp.maximum(place, 0)]
    by_pass = PassTrace(
        undecided=asked.present,
        reason=jnp.where(asked.present, asked.reason, 0),
        option_id=name(option),
        option_score=jnp.where(option >= 0, asked.score, 0.0),
        root=answers.root,
        status=of_group(groups.status),
        proposed_id=name(answers.proposed),
        score=number["score"],
        second=number["second"],
        core_gap=number["core_gap"],
        evidence=number["evidence"],
        anchor_id=name(anchor),
        anchor_detection=place,
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
        valid=h.valid,
    )
