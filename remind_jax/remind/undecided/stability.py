"""Assignments among look-alikes that are too close to call.

Rules: method.md#identity-stability, method.md#stability-entries.

Matched detections of a class and their objects form components of rivals. In a small component the
two best complete assignments are compared; a component that leans on rescued pairs is solved again
greedily. What stays open becomes ambiguous. Letters: `N` detections, `O` objects, `M = 4` members
of a small component, `Q = 24` its assignments.
"""

from __future__ import annotations

import dataclasses
import itertools

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from remind_jax.decision import Reason
from remind_jax.numerics.absent import NO_SLOT
from remind_jax.numerics.control_flow import branch
from remind_jax.remind.association.gating import Gate
from remind_jax.remind.disambiguation.groups import Undecided
from remind_jax.remind.thresholds.outcome import Stability
from remind_jax.remind.undecided.temporal import PairTable, rank, temporal_score

MAX_MEMBERS = 4
_ORDERS = np.array(list(itertools.permutations(range(MAX_MEMBERS))), np.int32)


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Stabilized:
    """Matches after the guard."""

    slot: Int[Array, "N"]  # object slot, -1 none
    doubtful: Bool[Array, "N"]  # lost its match to doubt
    rivals: Bool[Array, "N O"]  # objects that a doubtful detection could be
    root: Int[Array, "N"]  # first detection of its group of look-alikes, N for none
    gap: Float[Array, "N"]  # lead of the best joint assignment of that group, inf if it has one


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class _Components:
    """Groups of matched detections that could swap objects."""

    root: Int[Array, "N"]  # smallest detection of the component, N for none
    edge: Bool[Array, "N O"]
    objects: Bool[Array, "N O"]  # objects of the component of each detection
    contested: Bool[Array, "N"]  # at least two detections and two objects


def stabilize(table: PairTable, slot: Int[Array, "N"], t: Stability) -> Stabilized:
    """Withdraws matches that a slightly different score would have swapped.

    Args:
      table: Scores and gates of all pairs.
      slot: Matched object of each detection, -1 none.
      t: Thresholds.
    """
    parts = _find_components(table, slot)
    contested = parts.contested & t.enabled
    first, second, close, gap = _compare_assignments(table, parts, t)
    settled = contested & close
    undecided = settled & (first != second)
    current = slot[:, None] == jnp.arange(parts.edge.shape[1])
    named = current | _one_hot(first, parts.edge) | _one_hot(second, parts.edge)
    few = jnp.sum(named, axis=1, keepdims=True) < 2
    rivals = jnp.where(few, parts.objects, named & parts.objects)

    slot_after = jnp.where(settled, jnp.where(undecided, NO_SLOT, first), slot)
    fragile = _is_fragile(table, parts, slot, t) & contested & ~settled

    def solve() -> tuple[Array, Array]:
        kept = _solve_greedily(table, parts, fragile, t)
        has = jnp.any(kept, axis=1)
        return has, jnp.where(has, jnp.argmax(kept, axis=1).astype(jnp.int32), NO_SLOT)

    def leave() -> tuple[Array, Array]:
        return jnp.ones_like(fragile), slot_after

    has, solved = branch(jnp.any(fragile), solve, leave)
    lost = fragile & ~has
    return Stabilized(
        slot=jnp.where(fragile, solved, slot_after).astype(jnp.int32),
        doubtful=undecided | lost,
        rivals=jnp.where(
            undecided[:, None], rivals, jnp.where(lost[:, None], parts.objects, False)
        ),
        root=parts.root,
        gap=gap,
    )


def doubt_entries(
    table: PairTable,
    stabilized: Stabilized,
    min_visual: Float[Array, ""],
    max_candidates: Int[Array, ""],
) -> Undecided:
    """Turns doubtful detections into ambiguous ones, if two plausible rivals remain.

    Rule: method.md#stability-entries.
    """
    members = stabilized.rivals & table.plausible & stabilized.doubtful[:, None]
    score = temporal_score(table, members)
    members = members & (score >= min_visual)
    slots, scores = rank(score, members, max_candidates, later_first=True)
    return Undecided(
        present=jnp.sum(members, axis=1) >= 2,
        slot=slots,
        score=scores,
        best=scores[:, 0],
        reason=jnp.full(slots.shape[0], Reason.KNOWN_BUT_AMBIGUOUS_IDENTITY_STABILITY, jnp.int32),
    )


def _one_hot(slots: Int[Array, "N"], like: Bool[Array, "N O"]) -> Bool[Array, "N O"]:
    return slots[:, None] == jnp.arange(like.shape[1])


def _find_components(table: PairTable, slot: Int[Array, "N"]) -> _Components:
    """Connects matched detections through the eligible pairs with matched objects."""
    num, width = table.pairs.eligible.shape
    matched = slot >= 0
    taken = jnp.any(slot[:, None] == jnp.arange(width), axis=0)
    edge = table.pairs.eligible & matched[:, None] & taken[None]
    links = edge.astype(jnp.float32)
    reach = (links @ links.T) > 0
    for _ in range(max(1, (num - 1).bit_length())):
        spread = reach.astype(jnp.float32)
        reach = (spread @ spread) > 0
    linked = jnp.any(edge, axis=1)
    root = jnp.where(linked, jnp.argmax(reach, axis=1).astype(jnp.int32), num)
    objects = (reach.astype(jnp.float32) @ links) > 0
    contested = linked & (jnp.sum(reach, axis=1) >= 2) & (jnp.sum(objects, axis=1) >= 2)
    return _Components(root, edge, objects, contested)


def _compare_assignments(
    table: PairTable, parts: _Components, t: Stability
) -> tuple[Int[Array, "N"], Int[Array, "N"], Bool[Array, "N"], Float[Array, "N"]]:
    """The two best complete assignments of each small component.

    Returns:
      The object of each detection in the best and in the second best assignment, whether the
      component has two and they are too close, and how far the best one leads.
    """
    num, width = parts.edge.shape
    known = table.pairs.score_known
    roots = jnp.arange(num)
    in_part = parts.root[None] == roots[:, None]
    objects = parts.objects & (parts.root == roots)[:, None]
    size = jnp.sum(in_part, axis=1)
    most = jnp.minimum(t.max_members, MAX_MEMBERS)
    small = (size == jnp.sum(objects, axis=1)) & (size <= most) & (size >= 2)

    # Detections by number of edges, then id; objects by id.
    degree = jnp.where(in_part, jnp.sum(parts.edge, axis=1)[None], width + 1)
    dets = jnp.argsort(degree, axis=1, stable=True)[:, :MAX_MEMBERS]
    dets = _pad_columns(dets, MAX_MEMBERS)
    objs = _pad_columns(jnp.argsort(~objects, axis=1, stable=True)[:, :MAX_MEMBERS], MAX_MEMBERS)
    member = jnp.arange(MAX_MEMBERS) < size[:, None]
    inner = member[:, :, None] & member[:, None, :]
    score = known[dets[:, :, None], objs[:, None, :]]
    edge = parts.edge[dets[:, :, None], objs[:, None, :]] & inner
    edge = edge | (~inner & jnp.eye(MAX_MEMBERS, dtype=bool))
    value = jnp.where(inner, score, 0.0)

    rows = jnp.arange(MAX_MEMBERS)
    feasible = jnp.all(edge[:, rows, _ORDERS], axis=-1)
    total = jnp.zeros(feasible.shape, value.dtype)
    for row in range(MAX_MEMBERS):  # summed in this order, as in the original
        total = total + value[:, row, _ORDERS[:, row]]
    # Equal totals keep the order of enumeration: each detection tries its best object first.
    tries = jnp.argsort(jnp.argsort(-value, axis=-1, stable=True), axis=-1, stable=True)
    place = jnp.sum(tries[:, rows, _ORDERS] * (MAX_MEMBERS ** (MAX_MEMBERS - 1 - rows)), axis=-1)

    def best(allowed: Bool[Array, "N Q"]) -> tuple[Array, Array]:
        top = jnp.max(jnp.where(allowed, total, -jnp.inf), axis=1)
        ties = allowed & (total == top[:, None])
        return jnp.argmin(jnp.where(ties, place, jnp.iinfo(jnp.int32).max), axis=1), top

    first, top = best(feasible)
    second, next_top = best(feasible & (jnp.arange(len(_ORDERS)) != first[:, None]))
    several = small & (jnp.sum(feasible, axis=1) >= 2)
    gap = jnp.where(several, jnp.maximum(0.0, top - next_top), jnp.inf)
    close = several & (gap <= t.assignment_gap)

    def spread(order: Int[Array, "N"]) -> Int[Array, "N"]:
        """From (component, member) back to detections."""
        chosen = jnp.take_along_axis(objs, jnp.asarray(_ORDERS)[order], axis=1)
        target = jnp.where(member & close[:, None], dets, num)
        return (
            jnp.full(num, NO_SLOT, jnp.int32).at[target].set(chosen.astype(jnp.int32), mode="drop")
        )

    is_close = jnp.any(in_part & close[:, None], axis=0)
    of_detection = jnp.min(jnp.where(in_part, gap[:, None], jnp.inf), axis=0)
    return spread(first), spread(second), is_close, of_detection


def _pad_columns(index: Int[Array, "N X"], width: int) -> Int[Array, "N W"]:
    lacking = width - index.shape[1]
    return jnp.pad(index, ((0, 0), (0, max(0, lacking))))


def _is_fragile(
    table: PairTable, parts: _Components, slot: Int[Array, "N"], t: Stability
) -> Bool[Array, "N"]:
    """Components with a fragile match that a rival pair beats (method.md#gating-fragile)."""
    known, width = table.pairs.score_known, parts.edge.shape[1]
    current = slot[:, None] == jnp.arange(width)
    gate = table.pairs.gate
    weak = t.rescued_fragile & (gate == Gate.SETS_RESCUE)
    weak = weak | (t.passed_fragile & (gate == Gate.PASS_MATCH_THR))
    fragile = jnp.any(current & weak & parts.edge, axis=1)
    mine = jnp.sum(jnp.where(current, known, 0.0), axis=1)
    other_object = jnp.max(jnp.where(parts.edge & ~current, known, -jnp.inf), axis=1)
    rivals = parts.edge[None] & current[:, None] & ~jnp.eye(len(slot), dtype=bool)[..., None]
    other_detection = jnp.max(jnp.where(rivals, known[None], -jnp.inf), axis=(1, 2))
    beaten = jnp.maximum(other_object, other_detection) >= mine + t.alternative_margin
    bad = fragile & beaten & parts.contested
    same = parts.root[:, None] == parts.root[None]
    return jnp.any(same & bad[None], axis=1) & parts.contested


def _solve_greedily(
    table: PairTable, parts: _Components, fragile: Bool[Array, "N"], t: Stability
) -> Bool[Array, "N O"]:
    """Takes pairs by falling score; rescued ones must lead their rivals.

    Rule: method.md#gating-fragile.
    """
    known, num = table.pairs.score_known, len(fragile)
    edge = parts.edge & fragile[:, None]
    order = jnp.lexsort(
        (-table.comparison.score.ravel(), -jnp.where(edge, known, -jnp.inf).ravel())
    )
    place = jnp.argsort(order, stable=True).reshape(edge.shape)
    last = jnp.iinfo(place.dtype).max

    def take(_: Array, carry: tuple[Array, Array]) -> tuple[Array, Array]:
        """Pairs that come first both in their row and in their column are taken."""
        taken, left = carry
        rank_left = jnp.where(left, place, last)
        first = left & (rank_left == jnp.min(rank_left, axis=1, keepdims=True))
        first = first & (rank_left == jnp.min(rank_left, axis=0, keepdims=True))
        free = ~jnp.any(first, axis=1)[:, None] & ~jnp.any(first, axis=0)[None]
        return taken | first, left & free

    taken, _ = jax.lax.fori_loop(0, num, take, (jnp.zeros_like(edge), edge))
    masked = jnp.where(edge, known, -jnp.inf)

    def best_other(axis: int) -> Float[Array, "N O"]:
        """Largest score of the other pairs in the same row or column."""
        top = jnp.max(masked, axis=axis, keepdims=True)
        is_top = masked == top
        single = jnp.sum(is_top & edge, axis=axis, keepdims=True) == 1
        rest = jnp.max(jnp.where(is_top, -jnp.inf, masked), axis=axis, keepdims=True)
        return jnp.where(is_top & single, rest, top)

    rival = jnp.maximum(best_other(0), best_other(1))
    stands = (table.pairs.gate == Gate.PASS_MATCH_THR) | (known >= rival + t.keep_margin)
    return taken & stands
