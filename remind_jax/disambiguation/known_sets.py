"""Settles closed groups of look-alikes by their distances to other objects (notes 11).

Letters: `N` detections, `O` object slots, `G` detections and `U` candidates of a group.
"""

from __future__ import annotations

import dataclasses
import enum

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from remind_jax.config.known_set_thresholds import KnownSets
from remind_jax.config.static import Static
from remind_jax.disambiguation.anchors import (
    Group,
    KnownScores,
    Voters,
    choose_anchors,
    find_voters,
)
from remind_jax.disambiguation.distance_evidence import DistanceEvidence, FrameRelations
from remind_jax.disambiguation.groups import Entries, Groups, form_groups
from remind_jax.disambiguation.joint_assignments import GroupStatus, score_assignments, settle

NO_SLOT = -1


class Source(enum.IntEnum):
    """What settled a detection here."""

    NONE = 0
    FULL = 1
    PARTIAL = 2


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class GroupAccount:
    """What became of each group; one row per detection, used by the root of a group.

    Numbers are 0 where a group was skipped before scoring.
    """

    root: Int[Array, "N"]  # the row itself if it is a root, else -1
    status: Int[Array, "N"]  # GroupStatus
    num_detections: Int[Array, "N"]
    num_candidates: Int[Array, "N"]  # virtual ones included
    num_anchors: Int[Array, "N"]  # an object that counts twice is counted twice
    score: Float[Array, "N"]  # of the best assignment
    second: Float[Array, "N"]  # of the runner-up, -1 without any
    gap: Float[Array, "N"]
    core: Float[Array, "N"]  # score of the best assignment without appearance
    core_gap: Float[Array, "N"]
    evidence: Float[Array, "N"]


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Settled:
    """Entries after one pass of the disambiguation."""

    resolved_slot: Int[Array, "N"]  # object, -1 none
    resolved_score: Float[Array, "N"]  # score_known of that object, 0 without any
    source: Int[Array, "N"]  # Source; also set where an entry gave way to a virtual object
    remaining: Bool[Array, "N"]  # entries that stay undecided
    root: Int[Array, "N"]  # root of the group of each entry, -1 outside groups
    proposed: Int[Array, "N"]  # candidate in the best assignment of the group, -1 if not scored
    groups: GroupAccount


def settle_known_sets(
    entries: Entries,
    matched_slot: Int[Array, "N"],
    matched_pass: Int[Array, "N"],
    scores: KnownScores,
    object_exists: Bool[Array, "O"],
    relations: FrameRelations,
    evidence: DistanceEvidence,
    static: Static,
    t: KnownSets,
) -> Settled:
    """Decides groups of entries that name exactly as many objects as there are detections.

    Each surrounding object votes on the order in which the detections lie around it. Whether a
    detection is a known object or a new one is never decided here, nor whether an accepted object
    is matched to another detection already.

    Args:
      entries: Undecided detections and their candidates.
      matched_slot: Current object of each detection, -1 none; that of an entry does not vote.
      matched_pass: Pass that made the match, 0 for the assignment. It only matters where two
        detections have the same object: the later match lends the object its place.
      scores: Scores of all detections for all objects.
      object_exists: Slots in use.
      relations: Distances between the detections of this frame.
      evidence: Distances remembered before this frame.
      static: Limits of groups and anchors.
      t: Thresholds.
    """

    def solve(_: None) -> Settled:
        groups = form_groups(entries, object_exists, relations, evidence, static, t)
        voters = find_voters(
            entries.present, matched_slot, matched_pass, object_exists, scores, static, t
        )
        start = _unsolved(entries, groups, scores.score.dtype)
        pending = groups.fits & groups.closed
        order = jnp.cumsum(pending, dtype=jnp.int32)

        def one(number: Int[Array, ""], settled: Settled) -> Settled:
            root = jnp.argmax(pending & (order == number + 1))
            return _settle_group(
                root, settled, entries, groups, voters, scores, relations, evidence, static, t
            )

        return jax.lax.fori_loop(0, order[-1], one, start)

    def skip(_: None) -> Settled:
        return _untouched(entries, scores.score.dtype)

    return jax.lax.cond(t.enabled & jnp.any(entries.present), solve, skip, None)


def _untouched(entries: Entries, scalar: jnp.dtype) -> Settled:
    """The answer where there is nothing to settle."""
    num = entries.present.shape[0]
    none, zero = jnp.full(num, -1, jnp.int32), jnp.zeros(num, jnp.int32)
    real = jnp.zeros(num, scalar)
    account = GroupAccount(none, zero, zero, zero, zero, real, real, real, real, real, real)
    return Settled(none, real, zero, entries.present, none, none, account)


def _unsolved(entries: Entries, groups: Groups, scalar: jnp.dtype) -> Settled:
    """Groups as they are before any is solved; those that cannot be solved have their status."""
    blank = _untouched(entries, scalar)
    is_root = groups.num_detections > 0
    status = jnp.where(groups.fits, GroupStatus.NOT_CLOSED, GroupStatus.TOO_LARGE_OR_SMALL)
    account = dataclasses.replace(
        blank.groups,
        root=jnp.where(is_root, jnp.arange(is_root.shape[0], dtype=jnp.int32), -1),
        status=jnp.where(is_root, status, GroupStatus.NONE).astype(jnp.int32),
        num_detections=groups.num_detections,
        num_candidates=groups.num_candidates,
    )
    return dataclasses.replace(blank, root=groups.root, groups=account)


def _settle_group(
    root: Int[Array, ""],
    settled: Settled,
    entries: Entries,
    groups: Groups,
    voters: Voters,
    scores: KnownScores,
    relations: FrameRelations,
    evidence: DistanceEvidence,
    static: Static,
    t: KnownSets,
) -> Settled:
    """Solves the group of `root` and writes down what became of it."""
    group = _extract_group(root, entries, groups, static)
    anchors = choose_anchors(group, voters, relations, evidence, static, t)
    at = (group.detection[:, None], group.slot)
    visual = jnp.where(scores.candidate[at], scores.score[at], 0.0)
    rated = score_assignments(group, anchors, visual, relations, evidence, t)
    solution = settle(rated, t)

    full = solution.status == GroupStatus.RESOLVED
    accepted = full | (solution.status == GroupStatus.PARTIAL_RESOLVED)
    scored = solution.status != GroupStatus.NO_ASSIGNMENT
    num = settled.root.shape[0]
    position = group.is_detection & (group.detection == jnp.arange(num)[:, None])  # [N, G]
    member = jnp.any(position, axis=1)
    place = jnp.argmax(position, axis=1)
    chosen = solution.choice[place]
    stored = group.stored[chosen]
    decided = member & accepted
    source = jnp.where(full, Source.FULL, Source.PARTIAL).astype(jnp.int32)
    row = jnp.arange(num) == root

    def note(old: Array, new: Array) -> Array:
        return jnp.where(row, new, old)

    before = settled.groups
    account = dataclasses.replace(
        before,
        status=note(before.status, solution.status),
        num_anchors=note(before.num_anchors, jnp.sum(anchors.votes, dtype=jnp.int32)),
        **{
            name: note(getattr(before, name), getattr(solution, name))
            for name in ("score", "second", "gap", "core", "core_gap", "evidence")
        },
    )
    return Settled(
        resolved_slot=jnp.where(decided & stored, group.slot[chosen], settled.resolved_slot),
        resolved_score=jnp.where(decided & stored, visual[place, chosen], settled.resolved_score),
        source=jnp.where(decided, source, settled.source),
        remaining=settled.remaining & ~decided,
        root=settled.root,
        proposed=jnp.where(member & scored, group.candidate[chosen], settled.proposed),
        groups=account,
    )


def _extract_group(root: Int[Array, ""], entries: Entries, groups: Groups, static: Static) -> Group:
    """Detections and candidates of one group, ascending."""
    num, width = entries.candidates.shape
    none = jnp.iinfo(jnp.int32).max
    member = groups.root == root
    size = min(static.group_size, static.group_candidates)
    index = jnp.where(member, jnp.arange(num, dtype=jnp.int32), none)
    index = jnp.pad(index, (0, size), constant_values=none)
    detection = jnp.sort(index)[:size]
    is_detection = detection != none
    detection = jnp.where(is_detection, detection, 0)

    fresh = (groups.fresh & member[:, None]).reshape(-1)
    flat = jnp.where(fresh, entries.candidates.reshape(-1), none)
    flat = jnp.pad(flat, (0, static.group_candidates), constant_values=none)
    candidate = jnp.sort(flat)[: static.group_candidates]
    is_candidate = candidate != none
    same = (groups.distinct & member[:, None])[:, :, None]
    same = same & (entries.candidates[:, :, None] == candidate)
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
