"""Which candidate is which detection, judged by the order of distances (notes 11.6, 11.7).

Letters: `G` detections and `U` candidates of a group, `R` joint assignments, `P` pairs of
detections, `X` pairs of candidates, `A` anchors.
"""

from __future__ import annotations

import dataclasses
import enum
import functools
import itertools

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from remind_jax.config.known_set_thresholds import KnownSets
from remind_jax.disambiguation.anchors import Anchors, Group, list_pairs, read_group_orders
from remind_jax.disambiguation.distance_evidence import (
    TINY,
    DistanceEvidence,
    FrameRelations,
    read_edges,
)

ROBUSTNESS_FLOOR = 0.10  # weight of an order that was never robust (context notes 11.6)


class GroupStatus(enum.IntEnum):
    """What became of a group (context notes 11.3, 11.7)."""

    NONE = 0  # no group
    TOO_LARGE_OR_SMALL = 1  # not solvable: sizes out of bounds
    NOT_CLOSED = 2  # not as many objects as detections
    NO_ASSIGNMENT = 3
    LOW_EVIDENCE = 4
    LOW_SCORE = 5
    VISUAL_RANK_FLIP = 6  # appearance would change what the layout says
    LOW_CORE_SCORE = 7
    LOW_CORE_GAP = 8
    RESOLVED = 9
    PARTIAL_RESOLVED = 10  # accepted whole as well, with a small lead


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class AssignmentScores:
    """Worth of every joint assignment, in the order of a depth-first search."""

    valid: Bool[Array, "R"]
    choice: Int[Array, "R G"]  # index into the candidates of the group
    score: Float[Array, "R"]
    core: Float[Array, "R"]  # without appearance
    evidence: Float[Array, "R"]  # summed weight of the anchors


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Solution:
    """The best joint assignment of a group and whether it is accepted."""

    status: Int[Array, ""]  # GroupStatus
    choice: Int[Array, "G"]  # index into the candidates of the group
    score: Float[Array, ""]
    second: Float[Array, ""]  # score of the runner-up, -1 without any
    gap: Float[Array, ""]
    core: Float[Array, ""]
    core_gap: Float[Array, ""]
    evidence: Float[Array, ""]


@functools.lru_cache
def list_injections(num_rows: int, num_columns: int) -> tuple[np.ndarray, np.ndarray]:
    """All ways to give each row a column of its own, in lexicographic order.

    Returns:
      The column of each row `[R, num_rows]`, and for every number n of rows in use the ways that
      are the first with their leading n columns `[num_rows + 1, R]`.
    """
    table = np.array(list(itertools.permutations(range(num_columns), num_rows)), np.int32)
    leading = np.zeros((num_rows + 1, len(table)), bool)
    for used in range(1, num_rows + 1):
        leading[used, np.unique(table[:, :used], axis=0, return_index=True)[1]] = True
    return table, leading


def score_assignments(
    group: Group,
    anchors: Anchors,
    visual: Float[Array, "G U"],
    relations: FrameRelations,
    evidence: DistanceEvidence,
    t: KnownSets,
) -> AssignmentScores:
    """Scores every way to give the detections of a group candidates of their own.

    Args:
      group: Detections and candidates.
      anchors: Objects that vote.
      visual: Score of each detection for each candidate.
      relations: Distances between the detections of the frame.
      evidence: Remembered distances.
      t: Thresholds.
    """
    valid, choice = _enumerate(group)
    fit, weight = _vote_by_pairs(group, anchors, relations, evidence, t)
    first, second = list_pairs(group.detection.shape[0])
    num_candidates = group.slot.shape[0]
    index = choice[:, first] * num_candidates + choice[:, second]
    pair = np.arange(len(first))
    pair_weight = weight[pair, index]  # [R, P, A]
    anchor_evidence = jnp.sum(pair_weight, axis=1)
    agreement = jnp.sum(fit[pair, index] * pair_weight, axis=1)
    agreement = agreement / jnp.where(anchor_evidence > TINY, anchor_evidence, 1.0)
    total = anchors.quality * anchor_evidence
    counted = (anchors.quality > TINY) & (anchor_evidence > TINY) & (total > TINY)
    total = jnp.where(counted, total * anchors.votes, 0.0)
    summed = jnp.sum(total, axis=1)
    safe = jnp.where(summed > TINY, summed, 1.0)
    core = jnp.sum(total * agreement, axis=1) / safe
    core = jnp.where(summed > TINY, core * (jnp.sum(total * anchors.quality, axis=1) / safe), 0.0)

    stored = group.stored[choice] & group.is_detection
    num_seen = jnp.sum(stored, axis=1)
    seen = jnp.where(stored, visual[np.arange(choice.shape[1]), choice], 0.0)
    look = jnp.sum(seen, axis=1) / jnp.maximum(1, num_seen)
    anchor_share = jnp.where(jnp.any(total > 0, axis=1), t.anchor_weight, 0.0)
    visual_share = jnp.where(num_seen > 0, t.visual_weight, 0.0)
    share = anchor_share + visual_share
    score = (anchor_share * core + visual_share * look) / jnp.where(share > TINY, share, 1.0)
    return AssignmentScores(valid & (share > TINY), choice, score, core, summed)


def settle(scores: AssignmentScores, t: KnownSets) -> Solution:
    """Takes the best assignment and asks whether it is good and clear enough."""
    index = jnp.arange(scores.score.shape[0])
    score = jnp.where(scores.valid, scores.score, -jnp.inf)
    core = jnp.where(scores.valid, scores.core, -jnp.inf)
    several = jnp.sum(scores.valid) > 1
    best = jnp.argmax(score)
    # Of equal cores, the one that comes first by score.
    core_best = jnp.argmax(jnp.where(core == jnp.max(core), score, -jnp.inf))

    def lead(values: Float[Array, "R"], top: Int[Array, ""]) -> tuple[Array, Array]:
        """The value next to that of `top`, and the lead of the best assignment before it."""
        rest = jnp.max(jnp.where(index == top, -jnp.inf, values))
        rest = jnp.where(several, rest, -1.0)
        own = values[best]
        return rest, jnp.where(rest >= 0.0, own - rest, own)

    second, gap = lead(score, best)
    _, core_gap = lead(core, core_best)
    evidence = scores.evidence[best]
    tests = (
        (~jnp.any(scores.valid), GroupStatus.NO_ASSIGNMENT),
        (evidence < t.min_evidence, GroupStatus.LOW_EVIDENCE),
        (score[best] < t.min_score, GroupStatus.LOW_SCORE),
        (best != core_best, GroupStatus.VISUAL_RANK_FLIP),
        (core[best] < t.min_core, GroupStatus.LOW_CORE_SCORE),
        (core_gap < t.min_core_gap, GroupStatus.LOW_CORE_GAP),
        (gap < t.full_gap, GroupStatus.PARTIAL_RESOLVED),
    )
    status = jnp.int32(GroupStatus.RESOLVED)
    for failed, code in reversed(tests):
        status = jnp.where(failed, jnp.int32(code), status)
    none = ~jnp.any(scores.valid)
    clear = lambda value: jnp.where(none, 0.0, value)  # noqa: E731
    return Solution(
        status=status,
        choice=scores.choice[best],
        score=clear(score[best]),
        second=clear(second),
        gap=clear(gap),
        core=clear(core[best]),
        core_gap=clear(core_gap),
        evidence=clear(evidence),
    )


def _enumerate(group: Group) -> tuple[Bool[Array, "R"], Int[Array, "R G"]]:
    """All allowed assignments in the order of a depth-first search, shortest lists first."""
    table, leading = list_injections(*group.allowed.shape)
    index = np.arange(table.shape[1])
    width = jnp.where(group.is_detection, jnp.sum(group.allowed, axis=1), table.shape[0])
    tied = (width == width[:, None]) & (index < index[:, None])
    depth = jnp.sum((width < width[:, None]) | tied, axis=1)
    choice = jnp.asarray(table)[:, depth]
    fits = group.allowed[index, choice] | ~group.is_detection
    used = jnp.sum(group.is_detection)
    return jnp.all(fits, axis=1) & jnp.asarray(leading)[used], choice


def _vote_by_pairs(
    group: Group,
    anchors: Anchors,
    relations: FrameRelations,
    evidence: DistanceEvidence,
    t: KnownSets,
) -> tuple[Float[Array, "P UU A"], Float[Array, "P UU A"]]:
    """How well two candidates fit two detections as seen from an anchor, and the weight of that.

    The second axis is the first detection's candidate times `U` plus the second one's.
    """
    num = group.slot.shape[0]
    u, v = np.divmod(np.arange(num * num, dtype=np.int32), num)
    x, y = list_pairs(num)
    pair_of = np.zeros((num, num), np.int32)
    pair_of[x, y] = pair_of[y, x] = np.arange(len(x))
    orders = jax.tree.map(
        lambda field: field[:, pair_of[u, v]].T,  # [UU, A]
        read_group_orders(group, anchors.slot[:, None], evidence, t),
    )
    edges = read_edges(evidence, group.slot[:, None], anchors.slot, group.stored[:, None], t)
    ref = jnp.maximum(1e-6, t.span_ref)

    i, j = list_pairs(group.detection.shape[0])
    seen = relations.distance[group.detection[:, None], anchors.place]  # [G, A]
    apart = jnp.abs(seen[i] - seen[j])[:, None]  # [P, 1, A]
    nearer = (seen[i] < seen[j])[:, None]
    expected = jnp.abs(edges.distance[u] - edges.distance[v])
    separation = jnp.minimum(1.0, jnp.maximum(apart, expected) / ref)  # [P, UU, A]
    fit = (nearer == (edges.distance[u] < edges.distance[v])).astype(seen.dtype)
    # The candidate given to the nearer detection, is it the first of its pair?
    is_first = nearer == (u < v)[:, None]
    order = jnp.where(is_first, orders.first, 1.0 - orders.first)
    known = (1.0 - t.order_weight) * fit + t.order_weight * order
    off = jnp.abs(apart - orders.margin) / jnp.maximum(1e-6, t.margin_ref)
    known = (1.0 - t.margin_weight) * known + t.margin_weight * jnp.exp(-off)
    fit = jnp.where(orders.seen, known, fit)
    robust = jnp.maximum(ROBUSTNESS_FLOOR, orders.robustness)
    trust = 0.5 * (edges.reliability[u] + edges.reliability[v])
    weight = trust * jnp.where(orders.seen, separation * robust, separation)
    usable = edges.usable[u] & edges.usable[v] & (u != v)[:, None] & (anchors.votes > 0)
    usable = usable & (group.is_detection[i] & group.is_detection[j])[:, None, None]
    usable = usable & (separation > TINY) & (weight > TINY)
    return fit, jnp.where(usable, weight, 0.0)
