"""Assignments among look-alikes that are too close to call.

Rules: method.md#identity-stability, method.md#stability-entries.

Matched detections of a class and their objects form components of rivals. In a small component the
two best complete assignments are compared; a component that leans on rescued pairs is solved again
greedily. What stays open becomes ambiguous. Letters: `N` detections, `O` objects, `M = 4` members
of a small component, `Q = 24` its assignments.
"""

from __future__ import annotations

import itertools

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from remind_jax.decision import Reason
from remind_jax.numerics.absent import NO_SLOT
from remind_jax.numerics.control_flow import branch
from remind_jax.numerics.pytree import pytree
from remind_jax.numerics.ranks import first_largest, largest
from remind_jax.numerics.reductions import connect, pick_in_rows, reduce_together
from remind_jax.remind.association.gating import Gate
from remind_jax.remind.disambiguation.groups import Undecided
from remind_jax.remind.thresholds.outcome import Stability
from remind_jax.remind.undecided.temporal import PairTable, rank, temporal_score, to_mask

MAX_MEMBERS = 4
_ORDERS = np.array(list(itertools.permutations(range(MAX_MEMBERS))), np.int32)
_TURNS = MAX_MEMBERS ** np.arange(MAX_MEMBERS - 1, -1, -1, dtype=np.int32)


@pytree
class Stabilized:
    """Matches after the guard."""

    slot: Int[Array, "N"]  # object slot, -1 none
    doubtful: Bool[Array, "N"]  # lost its match to doubt
    rivals: Bool[Array, "N O"]  # objects that a doubtful detection could be
    root: Int[Array, "N"]  # first detection of its group of look-alikes, N for none


@pytree
class _Components:
    """Groups of matched detections that could swap objects."""

    root: Int[Array, "N"]  # smallest detection of the component, N for none
    edge: Bool[Array, "N O"]
    degree: Int[Array, "N"]  # edges of each detection
    objects: Bool[Array, "N O"]  # objects of the component of each detection
    num_objects: Int[Array, "N"]
    contested: Bool[Array, "N"]  # at least two detections and two objects


def stabilize(table: PairTable, slot: Int[Array, "N"]) -> Stabilized:
    """Withdraws matches that a slightly different score would have swapped."""
    t = table.thresholds.stability
    parts = _find_components(table, slot)
    contested = parts.contested & t.enabled
    (first, second), close = _compare_assignments(table, parts, slot, t)
    settled = contested & close
    undecided = settled & (first != second)
    named = to_mask(jnp.stack([slot, first, second], axis=1), parts.edge.shape[1])
    few = jnp.sum(named, axis=1, keepdims=True) < 2
    rivals = jnp.where(few, parts.objects, named & parts.objects)

    slot_after = jnp.where(settled, jnp.where(undecided, NO_SLOT, first), slot)
    fragile = _is_fragile(table, parts, slot, t) & contested & ~settled

    def solve() -> tuple[Array, Array]:
        kept = _solve_greedily(table, parts, fragile, t)
        has, place = largest(kept)
        return has, jnp.where(has, place, NO_SLOT)

    def leave() -> tuple[Array, Array]:
        return jnp.ones_like(fragile), slot_after

    has, solved = branch(jnp.any(fragile), solve, leave, suits_all=True)
    lost = fragile & ~has
    return Stabilized(
        slot=jnp.where(fragile, solved, slot_after).astype(jnp.int32),
        doubtful=undecided | lost,
        rivals=jnp.where(
            undecided[:, None], rivals, jnp.where(lost[:, None], parts.objects, False)
        ),
        root=parts.root,
    )


def doubt_entries(table: PairTable, stabilized: Stabilized) -> Undecided:
    """Makes the doubtful ambiguous where two rivals remain (method.md#stability-entries)."""
    members = stabilized.rivals & table.plausible & stabilized.doubtful[:, None]
    score = temporal_score(table, members)
    members = members & (score >= table.thresholds.matching.min_visual)
    most = table.thresholds.ambiguous.max_candidates
    slots, scores = rank(score, members, most, later_first=True)
    return Undecided(
        present=jnp.sum(members, axis=1) >= 2,
        slot=slots,
        score=scores,
        best=scores[:, 0],
        reason=jnp.full(slots.shape[0], Reason.KNOWN_BUT_AMBIGUOUS_IDENTITY_STABILITY, jnp.int32),
    )


def _find_components(table: PairTable, slot: Int[Array, "N"]) -> _Components:
    """Connects matched detections through the eligible pairs with matched objects."""
    num, width = table.pairs.eligible.shape
    matched = slot >= 0
    taken = jnp.any(slot[:, None] == jnp.arange(width), axis=0)
    edge = table.pairs.eligible & matched[:, None] & taken[None]
    links = edge.astype(jnp.float32)
    reach = connect((links @ links.T) > 0)
    degree = jnp.sum(edge, axis=1, dtype=jnp.int32)
    (_, first), size = reduce_together(("top", reach), ("sum", reach), axis=1)
    root = jnp.where(degree > 0, first, num)
    objects = (reach.astype(jnp.float32) @ links) > 0
    num_objects = jnp.sum(objects, axis=1, dtype=jnp.int32)
    contested = (degree > 0) & (size >= 2) & (num_objects >= 2)
    return _Components(root, edge, degree, objects, num_objects, contested)


def _compare_assignments(
    table: PairTable, parts: _Components, slot: Int[Array, "N"], t: Stability
) -> tuple[Int[Array, "2 N"], Bool[Array, "N"]]:
    """The two best complete assignments of each small component.

    Returns:
      The object of each detection in the best and in the second best assignment, and whether the
      component has two and they are too close.
    """
    num = len(slot)
    row, member = jnp.arange(num), jnp.arange(MAX_MEMBERS)
    in_part = parts.root[None] == row[:, None]
    size = jnp.sum(in_part, axis=1)
    num_objects = jnp.where(parts.root == row, parts.num_objects, 0)
    most = jnp.minimum(t.max_members, MAX_MEMBERS)
    small = (size == num_objects) & (size <= most) & (size >= 2)

    # Detections by number of edges, then id. Where there are as many objects, each is that of a
    # detection: objects by id.
    degree = parts.degree
    before = (degree < degree[:, None]) | ((degree == degree[:, None]) & (row < row[:, None]))
    place = jnp.sum(in_part[:, None] & before, axis=2)
    at_place = (place[:, None] == member[:, None]) & in_part[:, None]  # [R, M, N]
    inside, dets = largest(at_place)
    own = jnp.where(inside, slot[dets], parts.edge.shape[1])
    own_place = jnp.sum(own[:, None] < own[:, :, None], axis=2)
    is_object = (own_place[:, None] == member[:, None]) & inside[:, None]
    objs = jnp.sum(jnp.where(is_object, own[:, None], 0), axis=2)
    inner = inside[:, :, None] & inside[:, None]
    edge = parts.edge[dets[:, :, None], objs[:, None, :]] & inner
    edge = edge | (~inner & jnp.eye(MAX_MEMBERS, dtype=bool))
    score = table.pairs.score_known[dets[:, :, None], objs[:, None, :]]
    value = jnp.where(inner, score, 0.0)

    feasible = jnp.all(edge[:, member, _ORDERS], axis=-1)
    total = jnp.zeros(feasible.shape, value.dtype)
    for each in range(MAX_MEMBERS):  # summed in this order, as in the original
        total = total + value[:, each, _ORDERS[:, each]]
    # Equal totals keep the order of enumeration: each detection tries its best object first.
    one, other = value[..., None], value[:, :, None]
    earlier = (other > one) | ((other == one) & (member < member[:, None]))
    tries = jnp.sum(earlier, axis=-1)
    turn = jnp.sum(tries[:, member, _ORDERS] * _TURNS, axis=-1)

    def best(allowed: Bool[Array, "N Q"]) -> tuple[Array, Array, Array]:
        top, number = reduce_together(
            ("max", jnp.where(allowed, total, -jnp.inf)), ("sum", allowed), axis=1
        )
        ties = allowed & (total == top[:, None])
        return jnp.argmin(jnp.where(ties, turn, jnp.iinfo(jnp.int32).max), axis=1), top, number

    first, top, number = best(feasible)
    second, next_top, _ = best(feasible & (jnp.arange(len(_ORDERS)) != first[:, None]))
    several = small & (number >= 2)
    close = several & (jnp.maximum(0.0, top - next_top) <= t.assignment_gap)

    # From (component, member) back to detections.
    order = jnp.asarray(_ORDERS)[jnp.stack([first, second])]
    chosen = jnp.take_along_axis(objs[None], order, axis=2)[..., None]  # [2, R, M, 1]
    named = at_place & close[:, None, None]
    objects = jnp.max(jnp.where(named, chosen, NO_SLOT), axis=(1, 2)).astype(jnp.int32)
    return objects, (parts.root < num) & close[jnp.minimum(parts.root, num - 1)]


def _is_fragile(
    table: PairTable, parts: _Components, slot: Int[Array, "N"], t: Stability
) -> Bool[Array, "N"]:
    """Components with a fragile match that a rival pair beats (method.md#gating-fragile)."""
    known, row, at = table.pairs.score_known, jnp.arange(len(slot)), jnp.maximum(slot, 0)
    gate, mine, is_edge = pick_in_rows(slot, table.pairs.gate, known, parts.edge)
    weak = t.rescued_fragile & (gate == Gate.SETS_RESCUE)
    weak = weak | (t.passed_fragile & (gate == Gate.PASS_MATCH_THR))
    fragile = weak & is_edge
    others = parts.edge & (jnp.arange(known.shape[1]) != slot[:, None])
    other_object = jnp.max(jnp.where(others, known, -jnp.inf), axis=1)
    rivals = parts.edge[:, at] & (row[:, None] != row)
    other_detection = jnp.max(jnp.where(rivals, known[:, at], -jnp.inf), axis=0)
    beaten = jnp.maximum(other_object, other_detection) >= mine + t.alternative_margin
    bad = fragile & beaten & parts.contested
    same = parts.root[:, None] == parts.root[None]
    return jnp.any(same & bad[None], axis=1) & parts.contested


def _solve_greedily(
    table: PairTable, parts: _Components, fragile: Bool[Array, "N"], t: Stability
) -> Bool[Array, "N O"]:
    """Takes pairs by falling score; rescued ones must lead rivals (method.md#gating-fragile)."""
    known, visual = table.pairs.score_known, table.comparison.score
    edge = parts.edge & fragile[:, None]
    masked = jnp.where(edge, known, -jnp.inf)
    row, column = np.indices(edge.shape)

    def take(_: Array, carry: tuple[Array, Array]) -> tuple[Array, Array]:
        taken, left = carry
        keys = [jnp.where(left, key, -jnp.inf) for key in (masked, visual)]
        at_row, at_column = first_largest(keys, left)[-2:]
        in_row, in_column = row == at_row, column == at_column
        return taken | (in_row & in_column), left & ~in_row & ~in_column

    taken, _ = jax.lax.fori_loop(0, len(fragile), take, (jnp.zeros_like(edge), edge))

    def best_other(scores: Float[Array, "X Y"]) -> Float[Array, "X Y"]:
        """Largest score of the other pairs in the same row."""
        top, place = largest(scores)
        is_best = jnp.arange(scores.shape[1]) == place[:, None]
        rest = jnp.max(jnp.where(is_best, -jnp.inf, scores), axis=1, keepdims=True)
        return jnp.where(is_best, rest, top[:, None])

    rival = jnp.maximum(best_other(masked), best_other(masked.T).T)
    stands = (table.pairs.gate == Gate.PASS_MATCH_THR) | (known >= rival + t.keep_margin)
    return taken & stands
