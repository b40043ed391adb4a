"""Which candidate is which detection, judged by the order of distances.

Rules: method.md#known-set-distances, method.md#known-set-verdict.

Letters: `G` detections and `U` candidates of a group, `R` joint assignments, `P` pairs
of detections, `A` anchors.
"""

from __future__ import annotations

import enum
import functools
import itertools
import math

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from remind_jax.errors import ConfigError
from remind_jax.numerics.pytree import pytree
from remind_jax.numerics.rounding import divide
from remind_jax.remind.disambiguation.anchors import Anchors, Group
from remind_jax.remind.disambiguation.distance_evidence import TINY, KnownDistances, PairOrders
from remind_jax.remind.perception.relations import Relations
from remind_jax.remind.thresholds.known_sets import KnownSets

ROBUSTNESS_FLOOR = 0.10  # weight of an order that was never robust (method.md#known-set-distances)
MAX_ASSIGNMENTS = 10_000  # of one group; all of them are scored at once
_TINY_REF = 1e-6

# What a solution says about itself: score of the best assignment, of the runner-up (-1 without
# any), their difference, and score of the best without appearance, its lead, weight of the anchors.
NUMBERS = ("score", "second", "gap", "core", "core_gap", "evidence")


class GroupStatus(enum.IntEnum):
    """What became of a group (method.md#closed-groups, method.md#known-set-verdict)."""

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


@pytree
class AssignmentScores:
    """Worth of every joint assignment, in the order of a depth-first search."""

    valid: Bool[Array, "R"]
    choice: Int[Array, "R G"]  # index into the candidates of the group
    score: Float[Array, "R"]
    core: Float[Array, "R"]  # without appearance
    evidence: Float[Array, "R"]  # summed weight of the anchors


@pytree
class Solution:
    """The best joint assignment of a group and whether it is accepted."""

    status: Int[Array, ""]  # GroupStatus
    choice: Int[Array, "G"]  # index into the candidates of the group
    numbers: Float[Array, "6"]  # NUMBERS; 0 without any assignment


@functools.lru_cache
def list_injections(num_rows: int, num_columns: int) -> tuple[np.ndarray, np.ndarray]:
    """All ways to give each row a column of its own, in lexicographic order.

    Returns the column of each row `[R, num_rows]`, and for every number n of rows in use the ways
    that are the first with their leading n columns `[num_rows + 1, R]`. Raises ConfigError if there
    are too many to score them all.
    """
    if (count := math.perm(num_columns, num_rows)) > MAX_ASSIGNMENTS:
        raise ConfigError(
            f"static.group_size and static.group_candidates allow groups of {num_rows} detections "
            f"and {num_columns} candidates, which have {count} joint assignments; at most "
            f"{MAX_ASSIGNMENTS} can be scored, so lower one of them"
        )
    table = np.array(list(itertools.permutations(range(num_columns), num_rows)), np.int32)
    leading = np.zeros((num_rows + 1, len(table)), bool)
    for used in range(1, num_rows + 1):
        leading[used, np.unique(table[:, :used], axis=0, return_index=True)[1]] = True
    return table, leading


def score_assignments(
    group: Group,
    vote: Float[Array, "P U U A"],
    weight: Float[Array, "P U U A"],
    anchors: Anchors,
    visual: Float[Array, "G U"],
    t: KnownSets,
) -> AssignmentScores:
    """Scores all ways to give detections candidates of their own, by what `vote_by_pairs` says."""
    valid, choice = _enumerate(group)
    size, num = group.allowed.shape
    first, second = np.triu_indices(size, 1)
    pair = (np.arange(len(first)) * num + choice[:, first]) * num + choice[:, second]
    votes = jnp.stack([vote * weight, weight], axis=-1).reshape(len(first) * num * num, -1)
    summed = jnp.sum(votes[pair], axis=1).reshape(len(choice), -1, 2)  # [R, A, 2]
    evidence = summed[..., 1]
    fit = summed[..., 0] / jnp.where(evidence > TINY, evidence, 1.0)
    quality = anchors.quality
    weighed = quality * evidence
    counted = (quality > TINY) & (evidence > TINY) & (weighed > TINY)
    weighed = jnp.where(counted, anchors.votes * weighed, 0.0)
    terms = jnp.stack([weighed, weighed * fit, weighed * quality], axis=-1)
    total, fits, qualities = jnp.sum(terms, axis=1).T
    safe = jnp.where(total > TINY, total, 1.0)
    core = (fits / safe) * (qualities / safe)

    stored = group.stored & group.is_detection[:, None]
    looks = jnp.stack([jnp.where(stored, visual, 0.0), stored.astype(visual.dtype)], axis=-1)
    looks = jnp.sum(looks.reshape(size * num, 2)[np.arange(size) * num + choice], axis=1)
    look = looks[:, 0] / jnp.maximum(1.0, looks[:, 1])
    anchor_share = jnp.where(total > TINY, t.anchor_weight, 0.0)
    visual_share = jnp.where(looks[:, 1] > 0, t.visual_weight, 0.0)
    share = anchor_share + visual_share
    score = (anchor_share * core + visual_share * look) / jnp.where(share > TINY, share, 1.0)
    return AssignmentScores(valid & (share > TINY), choice, score, core, total)


def settle(scores: AssignmentScores, t: KnownSets) -> Solution:
    """Takes the best assignment and asks whether it is good and clear enough."""
    rated = jnp.stack([scores.score, scores.core, scores.evidence])
    rated = jnp.where(scores.valid, rated, -jnp.inf)
    best = jnp.argmax(rated[0])
    score, core, evidence = rated[:, best]
    (_, second), (top_core, second_core) = jax.lax.top_k(rated[:2], 2)[0]
    none, alone = score == -jnp.inf, second == -jnp.inf

    def lead(value: Float[Array, ""], other: Float[Array, ""]) -> Float[Array, ""]:
        return jnp.where(other >= 0.0, value - other, value)

    gap, core_gap = lead(score, second), lead(core, second_core)
    tests = (
        (none, GroupStatus.NO_ASSIGNMENT),
        (evidence < t.min_evidence, GroupStatus.LOW_EVIDENCE),
        (score < t.min_score, GroupStatus.LOW_SCORE),
        # Of equal cores, the one that comes first by score is best.
        (core < top_core, GroupStatus.VISUAL_RANK_FLIP),
        (core < t.min_core, GroupStatus.LOW_CORE_SCORE),
        (core_gap < t.min_core_gap, GroupStatus.LOW_CORE_GAP),
        (gap < t.full_gap, GroupStatus.PARTIAL_RESOLVED),
    )
    status = jnp.int32(GroupStatus.RESOLVED)
    for failed, code in reversed(tests):
        status = jnp.where(failed, jnp.int32(code), status)
    second = jnp.where(alone, -1.0, second)
    numbers = jnp.stack([score, second, gap, core, core_gap, evidence])
    return Solution(status, scores.choice[best], jnp.where(none, 0.0, numbers))


def vote_by_pairs(
    group: Group,
    anchors: Anchors,
    edges: KnownDistances,
    orders: PairOrders,
    relations: Relations,
    t: KnownSets,
) -> tuple[Float[Array, "P U U A"], Float[Array, "P U U A"]]:
    """How well two candidates fit two detections as an anchor sees it, and the weight of that.

    Indexed by the pair (i, j) of detections, the candidate of i, the candidate of j and the anchor.

    Args:
      edges: From each candidate to each anchor, `[U, A]`.
      orders: Of each two candidates as seen from each anchor, `[U, U, A]`.
    """
    first, second = np.triu_indices(group.detection.shape[0], 1)
    seen = relations.distance[group.detection[:, None], anchors.place]  # [G, A]
    one, other = seen[np.stack([first, second])][:, :, None, None]
    apart, nearer = jnp.abs(one - other), one < other  # [P, 1, 1, A]
    expected = jnp.abs(edges.distance[:, None] - edges.distance)  # [U, U, A]
    separation = divide(jnp.maximum(apart, expected), jnp.maximum(_TINY_REF, t.span_ref))
    separation = jnp.minimum(1.0, separation)
    vote = (nearer == (edges.distance[:, None] < edges.distance)).astype(seen.dtype)
    # The candidate given to the nearer detection, is it the lower of the two?
    index = np.arange(group.slot.shape[0])
    lower = nearer == (index[:, None] < index)[..., None]
    order = jnp.where(lower, orders.first, 1.0 - orders.first)
    known = (1.0 - t.order_weight) * vote + t.order_weight * order
    off = divide(jnp.abs(apart - orders.margin), jnp.maximum(_TINY_REF, t.margin_ref))
    known = (1.0 - t.margin_weight) * known + t.margin_weight * jnp.exp(-off)
    robust = jnp.where(orders.seen, jnp.maximum(ROBUSTNESS_FLOOR, orders.robustness), 1.0)
    weight = 0.5 * (edges.reliability[:, None] + edges.reliability) * (separation * robust)
    usable = edges.usable[:, None] & edges.usable & (anchors.votes > 0)
    real = jnp.all(group.is_detection[np.stack([first, second])], axis=0)
    usable = usable & real[:, None, None, None] & (separation > TINY) & (weight > TINY)
    return jnp.where(orders.seen, known, vote), jnp.where(usable, weight, 0.0)


def _enumerate(group: Group) -> tuple[Bool[Array, "R"], Int[Array, "R G"]]:
    """All allowed assignments in the order of a depth-first search, shortest lists first."""
    table, leading = list_injections(*group.allowed.shape)
    index = np.arange(table.shape[1])
    width = jnp.where(group.is_detection, jnp.sum(group.allowed, axis=1), table.shape[0])
    earlier = (width == width[:, None]) & (index < index[:, None])
    depth = jnp.sum((width < width[:, None]) | earlier, axis=1)
    choice = jnp.asarray(table)[:, depth]
    fits = group.allowed[index, choice] | ~group.is_detection
    used = jnp.sum(group.is_detection)
    return jnp.all(fits, axis=1) & jnp.asarray(leading)[used], choice
