"""Which surrounding objects tell the candidates of a group apart?

Rules: method.md#known-set-voters, method.md#voter-usefulness, method.md#voter-selection.

Letters: `N` detections, `O` object slots, `V` possible anchors, `A` anchors of a group, `G`
detections and `U` candidates of a group.
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from remind_jax.numerics.absent import NO_SLOT
from remind_jax.numerics.pytree import pytree
from remind_jax.numerics.ranks import largest, pick_best
from remind_jax.numerics.reductions import reduce_together
from remind_jax.numerics.rounding import divide
from remind_jax.remind.association.gating import Pairs
from remind_jax.remind.disambiguation.distance_evidence import (
    INFORMATIVENESS_FLOOR,
    TINY,
    KnownDistances,
    PairOrders,
    rate_difference,
)
from remind_jax.remind.perception.relations import Relations
from remind_jax.remind.thresholds.known_sets import KnownSets
from remind_jax.static import Static

# Shares of span, pair orders and mean separation in the history, and what a single remembered
# distance is worth (method.md#voter-usefulness).
SPAN_SHARE, ORDER_SHARE, SEPARATION_SHARE = 0.58, 0.17, 0.25
SINGLE_EDGE = 0.50
# The limits of pairs and of group anchors never go below (method.md#voter-selection).
FEWEST_ANCHORS = 2


@pytree
class Voters:
    """Objects of this frame that may serve as anchors: decided ones, then likely ones.

    An object may occur twice and then counts twice.
    """

    valid: Bool[Array, "V"]
    slot: Int[Array, "V"]  # object
    place: Int[Array, "V"]  # detection whose geometry the object has
    factor: Float[Array, "V"]  # 1 if decided, less for likely objects


@pytree
class Group:
    """One group of entries; both lists are ascending and padded."""

    detection: Int[Array, "G"]
    is_detection: Bool[Array, "G"]
    candidate: Int[Array, "U"]  # object slot or virtual number
    is_candidate: Bool[Array, "U"]
    slot: Int[Array, "U"]  # object slot, 0 where not stored
    stored: Bool[Array, "U"]
    allowed: Bool[Array, "G U"]  # candidates of each detection


@pytree
class Anchors:
    """Anchors of one group by falling usefulness; an object occurs once."""

    votes: Int[Array, "A"]  # how often the anchor counts; 0: padding
    voter: Int[Array, "A"]  # index into the voters
    place: Int[Array, "A"]  # detection whose geometry the object has
    quality: Float[Array, "A"]  # how well it separates the group


def find_voters(
    undecided: Bool[Array, "N"],
    matched_slot: Int[Array, "N"],
    matched_pass: Int[Array, "N"],
    object_exists: Bool[Array, "O"],
    candidate: Bool[Array, "N O"],
    pairs: Pairs,
    static: Static,
    t: KnownSets,
) -> Voters:
    """Decided objects, and objects that an otherwise open detection most likely is.

    Of two detections of one object the later pass lends its geometry, then the later detection.
    """
    num = matched_slot.shape[0]
    decided = (matched_slot >= 0) & ~undecided
    pair_ok = candidate & pairs.eligible & object_exists
    pair_ok = pair_ok & (pairs.score_known >= t.soft_min_score) & t.soft_anchors
    pair_ok = pair_ok & ~(decided | undecided)[:, None]
    masked = jnp.where(pair_ok, pairs.score_known, -jnp.inf)
    # The last of equal objects has the highest id; the first of equal detections wins.
    best = masked.shape[1] - 1 - jnp.argmax(masked[:, ::-1], axis=1)
    claims = pair_ok & (jnp.arange(masked.shape[1]) == best[:, None])
    claimed = jnp.where(claims, masked, -jnp.inf)
    top, holder = largest(claimed, axis=0)
    limit = min(static.switches.soft_anchors or num, top.shape[0])
    best, likely = pick_best(top, top > -jnp.inf, limit, later_first=True)
    soft, soft_slot = best != NO_SLOT, jnp.maximum(best, 0)
    confidence = jnp.clip(likely, 0.0, 1.0)

    slot = jnp.concatenate([jnp.where(decided, matched_slot, 0), soft_slot])
    own_place = jnp.concatenate([jnp.arange(num, dtype=jnp.int32), holder[soft_slot]])
    same = decided & (matched_slot == slot[:, None])
    order = matched_pass * num + jnp.arange(num)
    lender = jnp.argmax(jnp.where(same, order, -1), axis=1).astype(jnp.int32)
    factor = (1.0 - t.soft_confidence) + t.soft_confidence * confidence
    return Voters(
        valid=jnp.concatenate([decided, soft]),
        slot=slot,
        place=jnp.where(jnp.any(same, axis=1), lender, own_place),
        factor=jnp.concatenate([jnp.ones(num, factor.dtype), factor]),
    )


def choose_anchors(
    group: Group,
    voters: Voters,
    quality: Float[Array, "V"],
    static: Static,
    t: KnownSets,
) -> Anchors:
    """The voters that separate the candidates most clearly (method.md#voter-selection)."""
    inside = group.is_candidate & (group.candidate == voters.slot[:, None])
    valid = voters.valid & ~jnp.any(inside, axis=1)
    score = jnp.where(valid, quality * voters.factor, -jnp.inf)
    # Falling score, then falling id; two entries of one object are interchangeable.
    index = jnp.arange(score.shape[0])
    same_slot = voters.slot[:, None] == voters.slot
    behind = (voters.slot[:, None] < voters.slot) | (same_slot & (index[:, None] > index))
    ahead = (score > score[:, None]) | ((score == score[:, None]) & behind)
    rank = jnp.sum(ahead, axis=1)
    best = jnp.maximum(jnp.max(score), 0.0)
    floor = jnp.maximum(t.min_usefulness, t.usefulness_share * best)
    pairs = jnp.minimum(t.max_pairs, static.switches.group_anchors)
    limit = jnp.minimum(t.max_anchors, jnp.maximum(FEWEST_ANCHORS, pairs))
    chosen = valid & (rank < limit) & (score >= floor)
    room = max(FEWEST_ANCHORS, static.switches.group_anchors)
    at_rank = chosen & (rank == jnp.arange(room)[:, None])
    (found, voter), place, rated = reduce_together(
        ("top", at_rank),
        ("sum", jnp.where(at_rank, voters.place, 0)),
        ("sum", jnp.where(at_rank, quality, 0.0)),
        axis=1,
    )
    same = same_slot[voter]
    again = jnp.any(jnp.tril(same[:, voter] & found, -1), axis=1)
    votes = jnp.where(found & ~again, jnp.sum(same & valid, axis=1, dtype=jnp.int32), 0)
    return Anchors(votes, voter, place, rated)


def rate_anchors(
    group: Group,
    voters: Voters,
    edges: KnownDistances,
    orders: PairOrders,
    relations: Relations,
    t: KnownSets,
) -> Float[Array, "V"]:
    """How well each voter separates the group, before and now (method.md#voter-usefulness).

    Args:
      edges: From each candidate to each voter, `[U, V]`.
      orders: Of each two candidates as seen from each voter, `[U, U, V]`.
    """
    history = _rate_history(edges, orders, t)
    gap = relations.gap[group.detection[:, None], voters.place]
    real = group.is_detection[:, None]
    farthest, nearest = reduce_together(
        ("max", jnp.where(real, gap, -jnp.inf)), ("min", jnp.where(real, gap, jnp.inf)), axis=0
    )
    frame = rate_difference(farthest - nearest, t.span_ref, t)
    weight = t.history_weight + t.frame_weight
    weighted = t.history_weight * history + t.frame_weight * frame
    mean = divide(weighted, jnp.where(weight > TINY, weight, 1.0))
    return jnp.where(weight > TINY, mean, 0.5 * (history + frame))


def _rate_history(edges: KnownDistances, orders: PairOrders, t: KnownSets) -> Float[Array, "V"]:
    """How well anchors used to separate the candidates."""
    usable = edges.has_gap
    count, support, reliability, farthest, nearest = reduce_together(
        ("sum", usable),
        ("sum", jnp.where(usable, edges.support, 0.0)),
        ("sum", jnp.where(usable, edges.reliability, 0.0)),
        ("max", jnp.where(usable, edges.distance, -jnp.inf)),
        ("min", jnp.where(usable, edges.distance, jnp.inf)),
        axis=0,
    )
    span, number = farthest - nearest, jnp.maximum(1, count)
    clear = rate_difference(jnp.where(count > 1, span, 0.0), t.span_ref, t)
    clear = jnp.where(count > 1, clear, jnp.where(count == 1, SINGLE_EDGE, 0.0))
    informative = 1.0 - t.support_penalty * (support / number)
    base = clear * (reliability / number) * jnp.maximum(INFORMATIVENESS_FLOOR, informative)

    num = edges.distance.shape[0]
    once = jnp.asarray(np.triu(np.ones((num, num), bool), 1))[..., None]
    measured = usable[:, None] & usable & once
    recommends = measured & orders.seen & (orders.consistency >= t.min_consistency)
    robust = jnp.where(recommends, orders.robustness, -jnp.inf).reshape(num * num, -1)
    robust = jax.lax.top_k(robust.T, num * (num - 1) // 2)[0]
    counted = jnp.isfinite(robust) & (jnp.arange(robust.shape[1]) < t.max_pairs)
    num_counted, order = reduce_together(
        ("sum", counted), ("sum", jnp.where(counted, robust, 0.0)), axis=1
    )
    order = order / jnp.maximum(1, num_counted)
    apart = jnp.where(measured, jnp.abs(edges.distance[:, None] - edges.distance), 0.0)
    num_measured = jnp.maximum(1, jnp.sum(measured, axis=(0, 1)))
    separation = rate_difference(jnp.sum(apart, axis=(0, 1)) / num_measured, t.span_ref, t)
    blend = SPAN_SHARE * base + ORDER_SHARE * order + SEPARATION_SHARE * separation
    return jnp.maximum(base, jnp.minimum(1.0, blend))
