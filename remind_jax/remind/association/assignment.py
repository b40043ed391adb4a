"""Who is who, jointly: locks of clear wins, then one assignment.

Rules: method.md#locks, method.md#joint-assignment.
"""

from __future__ import annotations

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from remind_jax.numerics.absent import NO_SLOT
from remind_jax.numerics.pytree import pytree
from remind_jax.numerics.ranks import rank_two
from remind_jax.numerics.reductions import pick_in_rows
from remind_jax.remind.association.diagnosis import Evidence, admit_by_status, grant_claims
from remind_jax.remind.association.gating import Pairs, gate_pairs, initial_pairs
from remind_jax.remind.association.similarity import Comparison
from remind_jax.remind.context.reasoning import Reasoning
from remind_jax.remind.stages import Lock
from remind_jax.remind.thresholds import Thresholds
from remind_jax.remind.thresholds.association import Matching
from remind_jax.solvers.assignment import assign
from remind_jax.solvers.greedy import assign_greedily
from remind_jax.static import Static


@pytree
class Assignment:
    """Object slot of every detection."""

    slot: Int[Array, "N"]  # -1: no object
    score: Float[Array, "N"]  # final score of the pair, 0 without object
    lock: Int[Array, "N"]  # stages.Lock
    pairs: Pairs  # the table as last built


def associate(
    comparison: Comparison,
    evidence: Evidence,
    reasoning: Reasoning,
    class_id: Int[Array, "N"],
    static: Static,
    t: Thresholds,
) -> Assignment:
    """Settles clear wins first and assigns the rest jointly, class by class."""
    score, rules, matching = comparison.score, t.influence, t.matching
    num, slots = score.shape
    open_to_context = admit_by_status(
        evidence.status, rules.on_strong, rules.on_ambiguous, rules.on_weak
    )

    def gate(pairs: Pairs, rows: Bool[Array, "N"], used: Bool[Array, "O"]) -> Pairs:
        return gate_pairs(pairs, comparison, reasoning, open_to_context, rows, used, t)

    pairs = gate(initial_pairs(score), jnp.ones(num, bool), jnp.zeros(slots, bool))
    locked, lock = lock_pairs(pairs, score, matching)
    used, free = jnp.any(locked, axis=0), ~jnp.any(locked, axis=1)
    locked_score = jnp.sum(jnp.where(locked, pairs.score_final, 0.0), axis=1)

    pairs = gate(pairs, free, used)
    allowed, dummy = pairs.eligible & free[:, None], dummy_scores(evidence, matching)
    if static.switches.assignment == "greedy":
        column = assign_greedily(pairs.score_assign, allowed, dummy, matching.dummies)
    else:
        column = assign(
            pairs.score_assign, allowed, class_id, dummy, matching.dummies, solver=static.solver
        )
    final, visual = pick_in_rows(column, pairs.score_final, score)
    accepted = (column != NO_SLOT) & (final >= matching.match) & (visual >= matching.min_visual)
    solved = jnp.where(accepted, column, NO_SLOT)  # method.md#acceptance
    return Assignment(
        slot=jnp.where(free, solved, jnp.argmax(locked, axis=1).astype(jnp.int32)),
        score=jnp.where(free, jnp.where(accepted, final, 0.0), locked_score),
        lock=lock,
        pairs=pairs,
    )


def lock_pairs(
    pairs: Pairs, score: Float[Array, "N O"], t: Matching
) -> tuple[Bool[Array, "N O"], Int[Array, "N"]]:
    """Pairs that win so clearly that nothing else is asked, and the lock of each detection.

    Objects propose their best detection, then free detections propose their best free object. Where
    two proposals meet, the higher score wins, then the lower index (method.md#locks).
    """

    def wins(best: Array, second: Array) -> Bool[Array, "..."]:
        lead = best - second
        relative = lead / jnp.maximum(1e-12, best)
        lead_enough = (lead >= t.lock_gap) & (relative >= t.lock_relative_gap)
        return (best >= t.lock_score) & lead_enough & t.locks

    def propose(open_pairs: Bool[Array, "X Y"], scores: Float[Array, "X Y"]) -> Array:
        """Each row proposes its best column; of the proposals to a column the best stands."""
        best, top, second, number = rank_two(scores, open_pairs)
        return grant_claims((number > 0) & wins(top, second), best, top, scores.shape[1])

    by_object = propose(pairs.eligible.T, score.T).T & t.object_locks
    free = ~jnp.any(by_object, axis=1)[:, None] & ~jnp.any(by_object, axis=0)[None]
    by_detection = propose(pairs.eligible & free, score) & t.detection_locks
    kind = jnp.where(jnp.any(by_detection, axis=1), Lock.DETECTION, Lock.NONE)
    kind = jnp.where(jnp.any(by_object, axis=1), Lock.OBJECT, kind)
    return by_object | by_detection, kind.astype(jnp.int32)


def dummy_scores(evidence: Evidence, t: Matching) -> Float[Array, "N"]:
    """Score of staying without an object; uncertain ones give way (method.md#dummy-columns)."""
    base = jnp.clip(t.dummy_score, 0.0, 1.0)
    doubt = 1.0 - jnp.clip(evidence.confidence, 0.0, 1.0)
    scaled = jnp.clip(base + t.dummy_confidence_gain * doubt, 0.0, t.dummy_cap)
    diagnosed = evidence.status != 0
    return jnp.where(t.dummy_by_confidence & diagnosed, scaled, base)
