"""What became of each detection? (method.md#outcome, method.md#outcomes)."""

from __future__ import annotations

import dataclasses

import jax.numpy as jnp
from jaxtyping import Array, Bool, Int

from remind_jax.decision import Decisions, Outcome, Reason, Status
from remind_jax.numerics.absent import NO_ID
from remind_jax.numerics.columns import columns
from remind_jax.numerics.ranks import pick_best
from remind_jax.numerics.row_lookup import look_up_in_rows
from remind_jax.remind.association.assignment import Assignment
from remind_jax.remind.association.diagnosis import Evidence
from remind_jax.remind.association.quality import Quality
from remind_jax.remind.association.similarity import Comparison
from remind_jax.remind.memory.objects import Objects
from remind_jax.remind.perception.description import DescribedFrame
from remind_jax.remind.perception.relations import Relations
from remind_jax.remind.stages import Stages
from remind_jax.remind.state import TrackerState
from remind_jax.remind.undecided.settlement import Settlement
from remind_jax.remind.undecided.temporal import PairTable
from remind_jax.static import Static


@dataclasses.dataclass(frozen=True)
class Intermediates:
    """Intermediate results of one step, as they arise."""

    state: TrackerState  # before the frame
    quality: Quality
    relations: Relations
    anchors: Bool[Array, "N O"]
    table: PairTable
    assignment: Assignment
    settlement: Settlement
    stages: Stages


def decide(
    objects: Objects,
    seen: DescribedFrame,
    table: PairTable,
    anchors: Bool[Array, "N O"],
    evidence: Evidence,
    final: Evidence,
    assignment: Assignment,
    settlement: Settlement,
    static: Static,
) -> tuple[Decisions, Stages]:
    """Writes down the decisions; memory fills in the ids of new objects and pending tracks."""
    descriptors, masks = seen.descriptors, seen.masks
    outcome, reason, score = _verdicts(settlement)
    usable = descriptors.valid
    given = jnp.where(masks.valid, Outcome.DROPPED, Outcome.EMPTY)
    why = jnp.where(masks.valid, Reason.INVALID_INPUT, Reason.NONE)

    comparison, pairs = table.comparison, table.pairs
    candidate_id, rows = rank_candidates(objects, comparison, static.num_candidates)

    def take(*values: Array) -> Array:
        """Values of the candidates, side by side: they are looked up at once."""
        shown = look_up_in_rows(columns(*values), rows)
        return jnp.where((candidate_id != NO_ID)[..., None], shown, 0)

    reals = take(comparison.score, pairs.score_final, pairs.bonus)
    flags = (flag.astype(jnp.int32) for flag in (pairs.eligible, table.plausible))
    eligible, plausible, gate = jnp.moveaxis(take(*flags, pairs.gate), -1, 0)
    owners = objects.id_of(columns(settlement.slot, assignment.slot, settlement.stabilized.slot))
    is_ambiguous = settlement.ambiguous.present[:, None]
    doubts = settlement.doubts
    option = jnp.where(is_ambiguous, settlement.ambiguous.slot, doubts.support)
    option_score = jnp.where(is_ambiguous, settlement.ambiguous.score, doubts.support_score)
    stages = Stages(
        status_final=jnp.where(masks.valid, final.status, Status.NONE),
        num_close=evidence.num_close,
        is_anchor=jnp.any(anchors, axis=1),
        lock=assignment.lock,
        assigned_id=owners[:, 1],
        guarded_id=owners[:, 2],
        source=jnp.where(settlement.slot >= 0, settlement.source, 0).astype(jnp.int32),
        candidate_gate=gate,
        candidate_bonus=reals[..., 2],
    )
    decisions = Decisions(
        outcome=jnp.where(usable, outcome, given).astype(jnp.int32),
        reason=jnp.where(usable, reason, why).astype(jnp.int32),
        object_id=owners[:, 0],
        pending_id=jnp.full_like(rows[:, 0], NO_ID),
        score=jnp.where(usable, score, 0.0),
        status=jnp.where(masks.valid, evidence.status, Status.NONE),
        confidence=evidence.confidence,
        best_score=evidence.best_score,
        second_score=evidence.second_score,
        option_id=named_ids(objects, option, settlement.reserved_id),
        option_score=jnp.where(option >= 0, option_score, 0.0),
        option_blocked=doubts.blocked,
        candidate_id=candidate_id,
        candidate_score=reals[..., 0],
        candidate_final=reals[..., 1],
        candidate_eligible=eligible > 0,
        candidate_plausible=plausible > 0,
        num_bad_patches=descriptors.num_bad_patches,
    )
    return decisions, stages


def _verdicts(settlement: Settlement) -> tuple[Array, Array, Array]:
    """Outcome, reason and score of usable detections, in the order of precedence."""
    s, doubts = settlement, settlement.doubts
    outcome = jnp.full(s.slot.shape, Outcome.UNASSIGNED)
    reason = jnp.full(s.slot.shape, Reason.NO_ASSIGNMENT)
    score = jnp.zeros_like(s.score)
    is_parent = doubts.reason == Reason.UNCERTAIN_PARENT
    provisional = jnp.where(is_parent, Outcome.PROVISIONAL_PARENT, Outcome.PROVISIONAL_NEW)
    for present, what, why, value in (
        (s.slot >= 0, Outcome.MATCH, Reason.ASSIGNED, s.score),
        (s.creates, Outcome.NEW, Reason.CREATED_NEW, 0.0),
        (doubts.present, provisional, doubts.reason, doubts.best),
        (s.ambiguous.present, Outcome.AMBIGUOUS, s.ambiguous.reason, s.ambiguous.best),
    ):
        outcome = jnp.where(present, what, outcome)
        reason = jnp.where(present, why, reason)
        score = jnp.where(present, value, score)
    return outcome, reason, score


def named_ids(
    objects: Objects, slot: Int[Array, "*any"], reserved_id: Int[Array, "N"]
) -> Int[Array, "*any"]:
    """Ids of the named objects, those that the frame founds included."""
    width = objects.id.shape[0]
    known = objects.id[jnp.clip(slot, 0, width - 1)]
    founded = reserved_id[jnp.clip(slot - width, 0, len(reserved_id) - 1)]
    return jnp.where(slot < 0, NO_ID, jnp.where(slot < width, known, founded))


def rank_candidates(
    objects: Objects, comparison: Comparison, num_shown: int
) -> tuple[Int[Array, "N C"], Int[Array, "N C"]]:
    """The ids of the visually best candidates, by falling score and rising id, and their slots."""
    rows, _ = pick_best(comparison.score, comparison.candidate, num_shown)
    return objects.id_of(rows), jnp.maximum(rows, 0)
