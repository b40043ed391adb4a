"""What became of each detection? (association notes 17)."""

from __future__ import annotations

import jax
import jax.numpy as jnp
from jaxtyping import Array, Int

from remind_jax.association.assignment import Assignment
from remind_jax.association.diagnosis import Evidence
from remind_jax.association.similarity import Comparison
from remind_jax.config.static import Static
from remind_jax.decision import NO_ID, Decisions, Outcome, Reason
from remind_jax.observation import Descriptors, Masks
from remind_jax.state import Objects


def decide(
    objects: Objects,
    masks: Masks,
    descriptors: Descriptors,
    comparison: Comparison,
    evidence: Evidence,
    final: Evidence,
    assignment: Assignment,
    static: Static,
) -> Decisions:
    """Turns the assignment into outcomes; ids of new objects are filled in by memory.

    Args:
      objects: Objects known before the frame.
      masks: Detections of the frame.
      descriptors: Which of them are usable.
      comparison: Visual scores.
      evidence: Diagnosis of the visual scores.
      final: Diagnosis of the final scores of eligible pairs.
      assignment: Object of each detection.
      static: Number of candidates shown.
    """
    matched, usable = assignment.slot >= 0, descriptors.valid
    object_id = jnp.where(matched, objects.id[assignment.slot], NO_ID)
    outcome = jnp.where(matched, Outcome.MATCH, Outcome.NEW)
    outcome = jnp.where(masks.valid, jnp.where(usable, outcome, Outcome.DROPPED), Outcome.EMPTY)
    reason = jnp.where(matched, Reason.ASSIGNED, Reason.CREATED_NEW)
    reason = jnp.where(masks.valid, jnp.where(usable, reason, Reason.INVALID_INPUT), Reason.NONE)
    candidate_id, rows = rank_candidates(objects, comparison, static.num_candidates)

    def take(values: Array) -> Array:
        shown = jnp.take_along_axis(values, rows, axis=1)
        return jnp.where(candidate_id != NO_ID, shown, jnp.zeros((), values.dtype))

    return Decisions(
        outcome=outcome.astype(jnp.int32),
        reason=reason.astype(jnp.int32),
        object_id=object_id,
        pending_id=jnp.full_like(object_id, NO_ID),
        score=assignment.score,
        status=evidence.status,
        status_final=final.status,
        confidence=evidence.confidence,
        best_score=evidence.best_score,
        second_score=evidence.second_score,
        num_close=evidence.num_close,
        lock=assignment.lock,
        assigned_id=object_id,
        candidate_id=candidate_id,
        candidate_score=take(comparison.score),
        candidate_final=take(assignment.pairs.score_final),
        candidate_eligible=take(assignment.pairs.eligible),
        num_bad_patches=descriptors.num_bad_patches,
    )


def rank_candidates(
    objects: Objects, comparison: Comparison, num_shown: int
) -> tuple[Int[Array, "N C"], Int[Array, "N C"]]:
    """The ids of the visually best candidates, by falling score and rising id, and their slots."""
    masked = jnp.where(comparison.candidate, comparison.score, -jnp.inf)
    shown = min(num_shown, masked.shape[1])
    top, rows = jax.lax.top_k(masked, shown)
    ids = jnp.where(jnp.isfinite(top), objects.id[rows], NO_ID)
    lacking = ((0, 0), (0, num_shown - shown))
    return jnp.pad(ids, lacking, constant_values=NO_ID), jnp.pad(rows, lacking)
