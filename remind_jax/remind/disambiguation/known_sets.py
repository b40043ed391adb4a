"""Settles closed groups of look-alikes by their distances to other objects (method.md#known-sets).

Letters: `N` detections, `O` object slots, `G` detections and `U` candidates of a group.
"""

from __future__ import annotations

import dataclasses

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from remind_jax.numerics.absent import NO_SLOT
from remind_jax.numerics.control_flow import branch
from remind_jax.numerics.pytree import choose, pytree
from remind_jax.numerics.ranks import count_before
from remind_jax.numerics.reductions import Kind, reduce_together
from remind_jax.remind.association.gating import Pairs
from remind_jax.remind.disambiguation.anchors import (
    FEWEST_ANCHORS,
    Group,
    Voters,
    choose_anchors,
    find_voters,
    rate_anchors,
)
from remind_jax.remind.disambiguation.distance_evidence import (
    KnownDistances,
    PairOrders,
    read_edges,
    read_orders,
    tabulate_edges,
)
from remind_jax.remind.disambiguation.groups import Groups, Undecided, form_groups
from remind_jax.remind.disambiguation.joint_assignments import (
    NUMBERS,
    GroupStatus,
    score_assignments,
    settle,
    vote_by_pairs,
)
from remind_jax.remind.memory.distances import DistanceGraph
from remind_jax.remind.perception.relations import Relations
from remind_jax.remind.stages import MatchOrigin
from remind_jax.remind.thresholds.known_sets import KnownSets
from remind_jax.static import Static


@pytree
class GroupOutcome:
    """What became of each group; one row per detection, used by the root of a group.

    Numbers are 0 where a group was skipped before scoring.
    """

    status: Int[Array, "N"]  # GroupStatus
    num_detections: Int[Array, "N"]
    num_anchors: Int[Array, "N"]  # an object that counts twice is counted twice
    numbers: Float[Array, "N 6"]  # joint_assignments.NUMBERS
    anchor: Int[Array, "N A"]  # objects whose distances voted, -1 padding
    anchor_place: Int[Array, "N A"]  # detection whose geometry each of them has


@pytree
class Settled:
    """Entries after one pass of the disambiguation."""

    resolved_slot: Int[Array, "N"]  # object, -1 none
    resolved_score: Float[Array, "N"]  # score_known of that object, 0 without any
    source: Int[Array, "N"]  # stages.MatchOrigin
    remaining: Bool[Array, "N"]  # entries that stay undecided; one given a virtual object does not
    root: Int[Array, "N"]  # root of the group of each entry, -1 outside groups
    proposed: Int[Array, "N"]  # candidate in the best assignment of the group, -1 if not scored
    groups: GroupOutcome


def settle_known_sets(
    undecided: Undecided,
    class_id: Int[Array, "N"],
    matched_slot: Int[Array, "N"],
    matched_pass: Int[Array, "N"],
    candidate: Bool[Array, "N O"],
    pairs: Pairs,
    object_exists: Bool[Array, "O"],
    relations: Relations,
    graph: DistanceGraph,
    static: Static,
    t: KnownSets,
) -> Settled:
    """Decides groups of entries that name exactly as many objects as there are detections.

    Each surrounding object votes on the order in which the detections lie around it. Whether a
    detection is a known object or a new one is never decided here, nor whether an accepted object
    is matched to another detection already.

    Args:
      matched_slot: Current object of each detection, -1 none; that of an entry does not vote.
      matched_pass: Pass that made the match, 0 for the assignment. It only matters where two
        detections have the same object: the later match lends the object its place.
      candidate: Pairs that were compared at all; the others score 0.
    """
    num, scalar = matched_slot.shape[0], pairs.score_known.dtype
    nothing = _no_outcome(num, static, scalar)
    nobody = jnp.full(num, NO_SLOT, jnp.int32)

    def solve() -> Settled:
        edge_table = tabulate_edges(graph.edges, t)
        groups = form_groups(
            undecided, class_id, object_exists, relations, edge_table, graph.edges.contact_count,
            static, t,
        )  # fmt: skip
        voters = find_voters(
            undecided.present, matched_slot, matched_pass, object_exists, candidate, pairs,
            static, t,
        )  # fmt: skip
        known_score = jnp.where(candidate, pairs.score_known, 0.0)
        pending = groups.fits & groups.closed
        order = count_before(pending) + pending

        def solve_next(number: Array, solved: tuple[Array, GroupOutcome]):
            root = jnp.argmax(order == number + 1).astype(jnp.int32)
            group = extract_group(root, undecided, groups, static)
            return _solve_group(
                root, group, *solved, voters, known_score, relations, edge_table, graph, static, t
            )

        # Groups that cannot be solved have their status already.
        status = jnp.where(groups.fits, GroupStatus.NOT_CLOSED, GroupStatus.TOO_LARGE_OR_SMALL)
        status = jnp.where(groups.num_detections > 0, status, GroupStatus.NONE).astype(jnp.int32)
        unsolved = dataclasses.replace(nothing, status=status, num_detections=groups.num_detections)
        proposed, outcome = jax.lax.fori_loop(0, order[-1], solve_next, (nobody, unsolved))
        return _conclude(proposed, outcome, undecided, groups, known_score, object_exists)

    def skip() -> Settled:
        none = jnp.zeros(num, jnp.int32)
        return Settled(
            nobody, jnp.zeros(num, scalar), none, undecided.present, nobody, nobody, nothing
        )

    return branch(t.enabled & jnp.any(undecided.present), solve, skip)


def _no_outcome(num: int, static: Static, scalar: jnp.dtype) -> GroupOutcome:
    """No group at all."""
    none = jnp.zeros(num, jnp.int32)
    room = (num, max(FEWEST_ANCHORS, static.switches.group_anchors))
    nobody = jnp.full(room, NO_SLOT, jnp.int32)
    return GroupOutcome(
        status=none,
        num_detections=none,
        num_anchors=none,
        numbers=jnp.zeros((num, len(NUMBERS)), scalar),
        anchor=nobody,
        anchor_place=nobody,
    )


def _solve_group(
    root: Int[Array, ""],
    group: Group,
    proposed: Int[Array, "N"],
    outcome: GroupOutcome,
    voters: Voters,
    known_score: Float[Array, "N O"],
    relations: Relations,
    edge_table: Float[Array, "O O 4"],
    graph: DistanceGraph,
    static: Static,
    t: KnownSets,
) -> tuple[Int[Array, "N"], GroupOutcome]:
    """Solves one group; the candidate that each detection is given, and all groups so far."""
    slot, stored = group.slot, group.stored
    edges = read_edges(edge_table, slot[:, None], voters.slot, stored[:, None])
    pair_stored = (stored[:, None] & stored)[..., None]
    orders = read_orders(
        graph, voters.slot, slot[:, None, None], slot[None, :, None], pair_stored, t
    )
    quality = rate_anchors(group, voters, edges, orders, relations, t)
    anchors = choose_anchors(group, voters, quality, static, t)
    edges, orders = _of_voters(anchors.voter, edges, orders)
    vote, weight = vote_by_pairs(group, anchors, edges, orders, relations, t)
    visual = known_score[group.detection[:, None], slot]
    best = settle(score_assignments(group, vote, weight, anchors, visual, t), t)

    num = proposed.shape[0]
    is_root = jnp.arange(num) == root
    place = group.is_detection & (group.detection == jnp.arange(num)[:, None])  # [N, G]
    place = place & (best.status != GroupStatus.NO_ASSIGNMENT)
    given = jnp.sum(jnp.where(place, group.candidate[best.choice], 0), axis=1, dtype=jnp.int32)
    votes = anchors.votes > 0
    mine = {
        "status": best.status,
        "num_anchors": jnp.sum(anchors.votes, dtype=jnp.int32),
        "numbers": best.numbers,
        "anchor": jnp.where(votes, voters.slot[anchors.voter], NO_SLOT),
        "anchor_place": jnp.where(votes, anchors.place, NO_SLOT),
    }
    written = choose(is_root, mine, {name: getattr(outcome, name) for name in mine})
    proposed = jnp.where(jnp.any(place, axis=1), given, proposed)
    return proposed, dataclasses.replace(outcome, **written)


def _of_voters(
    voter: Int[Array, "A"], edges: KnownDistances, orders: PairOrders
) -> tuple[KnownDistances, PairOrders]:
    """What is remembered from some of the voters, all fields in one reduction."""
    is_voter = voter[:, None] == jnp.arange(edges.distance.shape[-1])
    leaves, structure = jax.tree.flatten((edges, orders))

    def of_voters(leaf: Array) -> tuple[Kind, Array]:
        picks = is_voter.reshape(*(1,) * (leaf.ndim - 1), *is_voter.shape)
        leaf = leaf[..., None, :]
        return ("any", picks & leaf) if leaf.dtype == bool else ("sum", jnp.where(picks, leaf, 0))

    # Edges do not depend on the first of two candidates.
    terms = [of_voters(leaf if leaf.ndim > 2 else leaf[None]) for leaf in leaves]
    found = reduce_together(*terms, axis=-1)
    picked = [
        leaf[0] if known.ndim < leaf.ndim else leaf
        for leaf, known in zip(found, leaves, strict=True)
    ]
    return jax.tree.unflatten(structure, picked)


def _conclude(
    proposed: Int[Array, "N"],
    outcome: GroupOutcome,
    undecided: Undecided,
    groups: Groups,
    known_score: Float[Array, "N O"],
    object_exists: Bool[Array, "O"],
) -> Settled:
    """What the solved groups mean for every detection."""
    in_group = groups.root >= 0
    status = jnp.where(in_group, outcome.status[jnp.maximum(groups.root, 0)], 0)
    full = status == GroupStatus.RESOLVED
    partial = status == GroupStatus.PARTIAL_RESOLVED
    source = jnp.where(full, MatchOrigin.DISTANCE_FULL, MatchOrigin.DISTANCE_PARTIAL)
    real = (proposed >= 0) & (proposed < object_exists.shape[0])
    slot = jnp.where(real, proposed, 0)
    real = real & object_exists[slot] & (full | partial)
    row = jnp.arange(slot.shape[0], dtype=jnp.int32)
    return Settled(
        resolved_slot=jnp.where(real, slot, NO_SLOT),
        resolved_score=jnp.where(real, known_score[row, slot], 0.0),
        source=jnp.where(real, source, MatchOrigin.NONE).astype(jnp.int32),
        remaining=undecided.present & ~(full | partial),
        root=groups.root,
        proposed=proposed,
        groups=outcome,
    )


def extract_group(
    root: Int[Array, ""], undecided: Undecided, groups: Groups, static: Static
) -> Group:
    """Detections and candidates of one group, ascending."""
    num = groups.root.shape[0]
    none = jnp.iinfo(jnp.int32).max
    member = groups.root == root
    # A closed group has two detections at least; smaller limits leave nothing to solve.
    room = max(2, static.switches.group_candidates)
    size = max(2, min(static.switches.group_size, room))
    index = jnp.where(member, jnp.arange(num, dtype=jnp.int32), none)
    index = jnp.pad(index, (0, size), constant_values=none)
    detection = jnp.sort(index)[:size]
    is_detection = detection != none
    detection = jnp.where(is_detection, detection, 0)

    fresh = (groups.fresh & member[:, None]).reshape(-1)
    flat = jnp.where(fresh, undecided.slot.reshape(-1), none)
    flat = jnp.pad(flat, (0, room), constant_values=none)
    candidate = jnp.sort(flat)[:room]
    is_candidate = candidate != none
    same = (groups.distinct & member[:, None])[:, :, None]
    same = same & (undecided.slot[:, :, None] == candidate)
    stored = jnp.any(same & groups.stored[:, :, None], axis=(0, 1))
    allowed = jnp.any(same, axis=1)[detection]
    return Group(
        detection=detection,
        is_detection=is_detection,
        candidate=jnp.where(is_candidate, candidate, NO_SLOT),
        is_candidate=is_candidate,
        slot=jnp.where(stored, candidate, 0),
        stored=stored,
        allowed=allowed & is_detection[:, None] & is_candidate,
    )
