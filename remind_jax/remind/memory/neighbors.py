"""Who was seen with whom in a frame: what both graphs of neighbors learn (paper III-D).

Letters: `N` detections, `O` object slots.
"""

from __future__ import annotations

import jax.numpy as jnp
from jaxtyping import Array, Bool, Int

from remind_jax.decision import Decisions, Outcome
from remind_jax.numerics.ranks import rank_rising
from remind_jax.remind.memory.cooccurrence import (
    CooccurrenceGraph,
    gather_sightings,
    update_cooccurrence,
)
from remind_jax.remind.memory.distances import DistanceGraph, update_distances
from remind_jax.remind.perception.relations import Relations
from remind_jax.remind.stages import Lock, MatchOrigin, Stages
from remind_jax.remind.thresholds import Thresholds
from remind_jax.static import Static


def decided_rank(
    decisions: Decisions,
    stages: Stages,
    source: Int[Array, "N"],
    class_id: Int[Array, "N"],
) -> Int[Array, "N"]:
    """Position of every detection in the order in which it got its object.

    Matches come before births; among the matches those of the assignment, class by class as
    the classes appear, locks first (method.md#locks, method.md#outcomes).
    """
    late = (source > MatchOrigin.ASSOCIATION).astype(jnp.int32)
    late = jnp.where(decisions.outcome == Outcome.NEW, 2, late)
    by_class = jnp.argmax(class_id[:, None] == class_id, axis=1)
    by_class = jnp.where(late == 0, by_class, 0)
    locked = (stages.lock != Lock.NONE) & (late == 0)
    lock = jnp.where(locked, stages.lock, Lock.DETECTION + 1)
    assigned = decisions.candidate_id == stages.assigned_id[:, None]
    score = jnp.sum(jnp.where(assigned, decisions.candidate_score, 0.0), axis=1)
    return rank_rising([late, by_class, lock, -jnp.where(locked, score, 0.0)])


def update_graphs(
    cooccurrence: CooccurrenceGraph,
    distances: DistanceGraph,
    now: Int[Array, ""],
    slot: Int[Array, "N"],
    order: Int[Array, "N"],
    ids: Int[Array, "O"],
    allowed: Bool[Array, "N"],
    relations: Relations,
    static: Static,
    t: Thresholds,
) -> tuple[CooccurrenceGraph, DistanceGraph]:
    """Notes who was seen with whom (method.md#episodes, method.md#distance-episodes).

    Args:
      slot: Object slot of every matched or created detection, out of range for others.
    """
    sightings = gather_sightings(slot, order, allowed, static.num_objects)
    cooccurrence, accepted = update_cooccurrence(
        cooccurrence, sightings, ids, now, static, t.cooccurrence
    )
    distances = update_distances(distances, relations, sightings, accepted, t.relations)
    return cooccurrence, distances
