"""Which undecided detections belong together, and which groups are closed?

Rules: method.md#undecided-groups, method.md#closed-groups.

Letters: `N` detections, `C` candidates of an entry, `O` object slots. A candidate is an object
slot; numbers from `O` on are virtual: objects that this frame may yet create.
"""

from __future__ import annotations

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from remind_jax.numerics.pytree import pytree
from remind_jax.numerics.reductions import connect, reduce_together
from remind_jax.remind.disambiguation.distance_evidence import (
    AGREEMENT_BASE,
    AGREEMENT_CONTACT,
    AGREEMENT_SUPPORT,
    INFORMATIVENESS_FLOOR,
    INFORMATIVENESS_SUPPORT,
    read_edges,
)
from remind_jax.remind.perception.relations import Relations
from remind_jax.remind.thresholds.known_sets import KnownSets
from remind_jax.static import Static


@pytree
class Undecided:
    """Detections that stay undecided, with the objects that each of them could be."""

    present: Bool[Array, "N"]
    slot: Int[Array, "N C"]  # object slots, -1 padding; `O + n`: the object that detection n founds
    score: Float[Array, "N C"]
    best: Float[Array, "N"]
    reason: Int[Array, "N"]  # decision.Reason


@pytree
class Groups:
    """Connected groups of entries; a group is named by its first detection, its root."""

    root: Int[Array, "N"]  # root of the group of each entry, -1 outside groups
    distinct: Bool[Array, "N C"]  # candidates without the repetitions within their entry
    stored: Bool[Array, "N C"]  # candidates that are objects in memory
    fresh: Bool[Array, "N C"]  # candidates without the repetitions within their group
    num_detections: Int[Array, "N"]  # by root; 0 elsewhere
    num_candidates: Int[Array, "N"]  # by root
    fits: Bool[Array, "N"]  # by root: small enough to be solved, large enough to be solvable
    closed: Bool[Array, "N"]  # by root: as many stored candidates as detections, at least two


def form_groups(
    undecided: Undecided,
    class_id: Int[Array, "N"],
    object_exists: Bool[Array, "O"],
    relations: Relations,
    edge_table: Float[Array, "O O 4"],
    contact: Int[Array, "O O 4"],
    static: Static,
    t: KnownSets,
) -> Groups:
    """Joins entries that compete for objects or stand as remembered objects stood."""
    candidates = undecided.slot
    num, width = candidates.shape
    filled = (candidates >= 0) & undecided.present[:, None]
    slot = jnp.where(filled & (candidates < object_exists.shape[0]), candidates, 0)
    stored = filled & (candidates < object_exists.shape[0]) & object_exists[slot]
    same = candidates[:, :, None] == candidates[:, None, :]
    earlier = jnp.tril(jnp.ones((width, width), bool), -1)
    distinct = filled & ~jnp.any(same & earlier & filled[:, None, :], axis=2)
    num_distinct, some = reduce_together(("sum", distinct), ("any", stored), axis=1)
    takes_part = num_distinct >= 2

    near = measure_affinity(slot, stored, relations, edge_table, contact, t) >= t.link_score
    linked = near | _share_candidates(candidates, filled)
    other_class = class_id[:, None] != class_id
    linked = linked & ~(other_class & some[:, None] & some)
    reach = connect(linked & takes_part[:, None] & takes_part)
    root = jnp.where(takes_part, jnp.argmax(reach, axis=1).astype(jnp.int32), -1)

    flat, label = candidates.reshape(-1), jnp.repeat(root, width)
    repeated = (flat[:, None] == flat) & (label[:, None] == label)
    before = repeated & jnp.tril(jnp.ones(repeated.shape, bool), -1) & distinct.reshape(-1)
    fresh = distinct & takes_part[:, None] & ~jnp.any(before, axis=1).reshape(num, width)

    member = root == jnp.arange(num)[:, None]

    num_fresh, num_fresh_stored = reduce_together(("sum", fresh), ("sum", fresh & stored), axis=1)
    each = jnp.stack([takes_part, num_fresh, num_fresh_stored, takes_part & ~some])
    counts = jnp.sum(jnp.where(member, each[:, None], 0), axis=2, dtype=jnp.int32)
    num_detections, num_candidates, num_stored, num_unknown = counts
    small = (num_detections <= static.switches.group_size) & (
        num_candidates <= static.switches.group_candidates
    )
    closed = (num_detections >= 2) & (num_stored == num_detections) & (num_unknown == 0)
    return Groups(
        root=root,
        distinct=distinct,
        stored=stored,
        fresh=fresh,
        num_detections=num_detections,
        num_candidates=num_candidates,
        fits=small & (num_candidates >= num_detections) & (num_detections > 0),
        closed=closed,
    )


def measure_affinity(
    slot: Int[Array, "N C"],
    stored: Bool[Array, "N C"],
    relations: Relations,
    edge_table: Float[Array, "O O 4"],
    contact: Int[Array, "O O 4"],
    t: KnownSets,
) -> Float[Array, "N N"]:
    """How well two detections stand to each other as any two of their candidates used to stand.

    Zero for detections far apart; symmetric (method.md#undecided-groups).
    """
    source, target = slot[:, :, None, None], slot[None, None]
    known = stored[:, :, None, None] & stored[None, None]
    edges = read_edges(edge_table, source, target, known)

    def spread(value: Array) -> Array:
        """Lays a relation of two detections out beside the edges of their candidates."""
        return value[:, None, :, None]

    sigma = jnp.where(edges.has_gap, t.gap_sigma, t.centre_sigma)
    similarity = jnp.exp(-jnp.abs(spread(relations.distance) - edges.distance) / sigma)
    episodes = contact[source, target]
    same = jnp.arange(episodes.shape[-1]) == spread(relations.contact)[..., None]
    hits = jnp.sum(jnp.where(same, episodes, 0), axis=-1)
    contact_share = hits / jnp.maximum(1, jnp.sum(episodes, axis=-1)).astype(similarity.dtype)
    support = spread(relations.support)
    agreement = AGREEMENT_BASE + AGREEMENT_CONTACT * contact_share
    unlike = jnp.abs(support - edges.support)
    agreement = agreement + AGREEMENT_SUPPORT * jnp.maximum(0.0, 1.0 - unlike)
    floor = INFORMATIVENESS_FLOOR
    informative = jnp.maximum(floor, 1.0 - INFORMATIVENESS_SUPPORT * edges.support)
    informative = informative * jnp.maximum(floor, 1.0 - t.support_penalty * support)
    quality = 1.0 - t.gap_quality_weight
    quality = quality + t.gap_quality_weight * jnp.clip(relations.gap_quality, 0.0, 1.0)
    truncated = relations.truncated.astype(quality.dtype)
    quality = quality * jnp.maximum(floor, 1.0 - t.truncation_penalty * truncated)
    weight = edges.reliability * jnp.maximum(floor, informative) * agreement * spread(quality)
    one_way = jnp.where(edges.usable, similarity * weight, 0.0)
    strength = 0.5 * (one_way + jnp.transpose(one_way, (2, 3, 0, 1)))
    return jnp.where(relations.distance <= t.link_distance, jnp.max(strength, axis=(1, 3)), 0.0)


def _share_candidates(
    candidates: Int[Array, "N C"], filled: Bool[Array, "N C"]
) -> Bool[Array, "N N"]:
    """Detections that name one and the same candidate."""
    equal = candidates[:, :, None, None] == candidates[None, None]
    return jnp.any(equal & filled[:, :, None, None] & filled[None, None], axis=(1, 3))
