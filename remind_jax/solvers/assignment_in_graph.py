"""In-graph twin of the joint assignment: SciPy's procedure with fixed shapes.

Rule: method.md#assignment-ties.

All groups are solved in one loop, one after the other, on *drivers* and *slots*. Drivers are what
SciPy enters row by row: the detections of a group, or its objects where SciPy would transpose.
Slots are what the drivers compete for: objects, a detection where transposed, and one slot that
stands for all dummies: a dummy that is taken costs as much as one that is free, so no search ever
passes through it, and in SciPy's order of visits dummies stay behind all objects.

The arithmetic is that of float64, whatever the precision of the scores, so that sums round and
ties fall exactly as in SciPy.

Letters: `N` rows (detections) and drivers, `M` columns (objects), `C` slots.
"""

from __future__ import annotations

from contextlib import AbstractContextManager
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from remind_jax.numerics.absent import NO_SLOT
from remind_jax.numerics.control_flow import branch, repeat

FORBIDDEN_COST = 1e6
_NO_KEY = 2**31 - 1


class _Problem(NamedTuple):
    """What the search reads; rows and drivers are sorted by group, those that take part first."""

    cost: Float[Array, "N C"]  # of each driver in each slot
    place: Int[Array, "N C"]  # of the slot among the open ones, by rising order; -1: not open
    start: Int[Array, "N"]  # first driver of the group
    num_drivers: Int[Array, ""]


class _Search(NamedTuple):
    """State between two visits; `driver` looks for the cheapest path to a slot without owner."""

    driver: Int[Array, ""]
    visited: Int[Array, ""]  # driver whose slots are looked at next, on the path of `driver`
    low: Float[Array, ""]  # length of the path to `visited`
    distance: Float[Array, "C"]  # of the shortest path to each slot
    previous: Int[Array, "C"]  # last driver on that path
    place: Int[Array, "C"]  # among the open slots; -1: closed or of another group
    entry: Float[Array, "N"]  # `low` when the driver was visited, inf: not visited
    driver_price: Float[Array, "N"]  # dual variables
    slot_price: Float[Array, "C"]
    owner: Int[Array, "C"]  # driver of each slot, of an earlier group: free
    settled: Int[Array, "N"]  # slot of drivers whose slot was taken over by a later group


def assign_in_graph(
    scores: Float[Array, "N M"],
    allowed: Bool[Array, "N M"],
    group: Int[Array, "N"],
    dummy: Float[Array, "N"],
    dummies: Bool[Array, ""],
    present: Bool[Array, "N M"] | None = None,
) -> Int[Array, "N"]:
    """Column of each row, as `remind_jax.solvers.assignment.assign_groups` gives it, ties included.

    Arguments as there. Scores must be finite where allowed. At most one visit per pair of driver
    and slot; as a rule few more visits than rows.
    """
    groups = _sort_groups(allowed, allowed if present is None else present, group, dummies)
    cost = jnp.where(allowed, -scores, FORBIDDEN_COST)
    problem, crossed, object_of = _pose(cost, groups, -dummy, dummies)
    owner, settled = _search(problem, dummies, scores.shape[1])
    holds = owner[None, :] == jnp.arange(len(settled), dtype=jnp.int32)[:, None]
    slot = jnp.where(jnp.any(holds, axis=1), jnp.argmax(holds, axis=1), -1)
    slot = jnp.where(settled >= 0, settled, slot).astype(jnp.int32)
    return _read_columns(slot, crossed, object_of, groups)


def double_precision() -> AbstractContextManager[Any]:
    """Lets float64 be used inside a traced function without the global switch."""
    return jax.enable_x64(True)


class _Groups(NamedTuple):
    order: Int[Array, "N"]  # rows by group, those that take no part last
    live: Bool[Array, "N"]
    allowed: Bool[Array, "N M"]
    same: Bool[Array, "N N"]  # both live and of one group
    start: Int[Array, "N"]
    columns: Bool[Array, "N M"]  # columns that the group of the row may use


def _sort_groups(
    allowed: Bool[Array, "N M"],
    present: Bool[Array, "N M"],
    group: Int[Array, "N"],
    dummies: Bool[Array, ""],
) -> _Groups:
    """Finds the rows that compete; one without allowed pair does so only where dummies do not."""
    active = jnp.any(allowed, axis=1)
    competes = jnp.any((group[:, None] == group[None, :]) & active[None, :], axis=1)
    live = jnp.where(dummies, active, competes)
    order = jnp.lexsort((group, ~live)).astype(jnp.int32)
    live, allowed, group = live[order], allowed[order], group[order]
    same = (group[:, None] == group[None, :]) & live[:, None] & live[None, :]
    reach = jnp.dot(same.astype(jnp.float32), present[order].astype(jnp.float32))
    start = jnp.argmax(same, axis=1).astype(jnp.int32)
    return _Groups(order, live, allowed, same, start, reach > 0)


def _pose(
    cost: Float[Array, "N M"], groups: _Groups, dummy_cost: Float[Array, "N"], dummies: Array
) -> tuple[_Problem, Bool[Array, "N"], Int[Array, "N"]]:
    """Lays out drivers and slots; also says which drivers are objects, and which objects."""
    num, columns = cost.shape
    slots = max(columns + 1, num)
    cost, dummy_cost = cost[groups.order], dummy_cost[groups.order]
    padding = ((0, 0), (0, slots - columns - 1))
    falling = columns - jnp.arange(columns, dtype=jnp.int32)
    place = jnp.where(groups.columns, falling[None, :], -1)
    last = jnp.broadcast_to(jnp.where(dummies, 0, -1).astype(jnp.int32), (num, 1))
    place = jnp.pad(jnp.concatenate([place, last], axis=1), padding, constant_values=-1)
    priced = jnp.pad(jnp.concatenate([cost, dummy_cost[:, None]], axis=1), padding)

    crossed, object_of, priced, place = branch(
        ~dummies,
        lambda: _cross(cost, groups, priced, place),
        lambda: (jnp.zeros(num, bool), jnp.zeros(num, jnp.int32), priced, place),
    )
    num_drivers = jnp.sum(groups.live, dtype=jnp.int32)
    return _Problem(priced, place, groups.start, num_drivers), crossed, object_of


def _cross(
    cost: Float[Array, "N M"],
    groups: _Groups,
    priced: Float[Array, "N C"],
    place: Int[Array, "N C"],
) -> tuple[Bool[Array, "N"], Int[Array, "N"], Float[Array, "N C"], Int[Array, "N C"]]:
    """Lets objects drive in groups of more detections than objects.

    Such a group has as many drivers as detections; those beyond the objects find no open slot.
    """
    num, slots = place.shape
    crossed = jnp.sum(groups.same, axis=1) > jnp.sum(groups.columns, axis=1)
    index = jnp.arange(num, dtype=jnp.int32)
    rank = jnp.cumsum(groups.columns, axis=1, dtype=jnp.int32) - 1
    drives = groups.columns & (rank == (index - groups.start)[:, None])
    object_of = jnp.argmax(drives, axis=1).astype(jnp.int32)
    competes = groups.same & jnp.any(drives, axis=1, keepdims=True)
    padding = ((0, 0), (0, slots - num))
    turned = jnp.where(competes, (num - index)[None, :], -1)
    turned = jnp.pad(turned, padding, constant_values=-1)
    priced = jnp.where(crossed[:, None], jnp.pad(cost[:, object_of].T, padding), priced)
    return crossed, object_of, priced, jnp.where(crossed[:, None], turned, place)


def _search(
    problem: _Problem, dummies: Bool[Array, ""], dummy_slot: int
) -> tuple[Int[Array, "C"], Int[Array, "N"]]:
    """Gives each driver in turn a slot by a shortest augmenting path.

    Returns:
      Driver of each slot, and the slot of drivers whose slot went to a driver of a later group.
    """
    with double_precision():
        cost = problem.cost.astype(jnp.float64)
        return _search_in_double(problem._replace(cost=cost), dummies, dummy_slot)


def _search_in_double(problem, dummies, dummy_slot):
    num, slots = problem.cost.shape
    none = jnp.full(slots, -1, jnp.int32)
    zero = jnp.int32(0)
    state = _Search(
        driver=zero,
        visited=zero,
        low=jnp.float64(0),
        distance=jnp.full(slots, jnp.inf, jnp.float64),
        previous=none,
        place=none,
        entry=jnp.full(num, jnp.inf, jnp.float64),
        driver_price=jnp.zeros(num, jnp.float64),
        slot_price=jnp.zeros(slots, jnp.float64),
        owner=none,
        settled=jnp.full(num, -1, jnp.int32),
    )
    no_owner = dummies & (jnp.arange(slots, dtype=jnp.int32) == dummy_slot)
    state = repeat(
        lambda state: state.driver < problem.num_drivers,
        lambda state: _visit(state, problem, no_owner),
        state,
    )
    return state.owner, state.settled


def _visit(state: _Search, problem: _Problem, no_owner: Bool[Array, "C"]) -> _Search:
    """Measures the open slots from one driver, closes the nearest, and ends or goes on there."""
    num, slots = problem.cost.shape
    slot_index, driver_index = (jnp.arange(size, dtype=jnp.int32) for size in (slots, num))
    driver, visited = state.driver, state.visited
    start = problem.start[driver]

    fresh = driver == visited
    low = jnp.where(fresh, 0.0, state.low)
    # Entries of a batch that are done wait for the others: without an open slot nothing changes.
    todo = jnp.where(driver < problem.num_drivers, problem.place[driver], -1)
    place = jnp.where(fresh, todo, state.place)
    entry = jnp.where(fresh, jnp.inf, state.entry)
    entry = jnp.where(driver_index == visited, low, entry)
    owned = state.owner >= start
    slot_price = jnp.where(owned, state.slot_price, 0.0)

    is_open = place >= 0
    length = low + problem.cost[visited] - state.driver_price[visited] - slot_price
    distance = jnp.where(fresh, jnp.inf, state.distance)
    shorter = is_open & (length < distance)
    distance = jnp.where(shorter, length, distance)
    previous = jnp.where(shorter, visited, state.previous)

    key = jnp.where(is_open, jnp.where(owned, place, -1 - place), _NO_KEY)
    low, key, slot, last = _nearest(jnp.where(is_open, distance, jnp.inf), key, slot_index, place)
    closed_place = jnp.where(key < 0, -1 - key, key)
    at_slot = slot_index == slot
    place = jnp.where(place == last, closed_place, place)
    place = jnp.where(at_slot, -1, place)
    found = low < jnp.inf
    ends = (key < 0) | ~found

    closed = (place < 0) & (distance < jnp.inf)
    paid = jnp.where(closed, slot_price - (low - distance), slot_price)
    priced = jnp.where(entry < jnp.inf, state.driver_price + (low - entry), state.driver_price)
    last_owner = state.owner[slot]
    gains = ends & found
    owner = _augment(state.owner, previous, at_slot, previous[slot], driver, gains)
    return _Search(
        driver=jnp.where(ends, driver + 1, driver),
        visited=jnp.where(ends, driver + 1, last_owner),
        low=low,
        distance=distance,
        previous=previous,
        place=place,
        entry=entry,
        driver_price=jnp.where(gains, priced, state.driver_price),
        slot_price=jnp.where(gains, paid, slot_price),
        owner=jnp.where(no_owner, -1, owner),
        settled=jnp.where(gains & (driver_index == last_owner), slot, state.settled),
    )


def _nearest(
    distance: Float[Array, "C"], key: Int[Array, "C"], slot: Int[Array, "C"], place: Int[Array, "C"]
) -> tuple[Float[Array, ""], Int[Array, ""], Int[Array, ""], Int[Array, ""]]:
    """Least distance; among equals least key: free before owned, free ones last listed first.

    Returns:
      Distance, key and index of that slot, and the last place of all open ones.
    """

    def less(left, right):
        nearer = (left[0] < right[0]) | ((left[0] == right[0]) & (left[1] < right[1]))
        best = tuple(jnp.where(nearer, x, y) for x, y in zip(left[:3], right[:3], strict=True))
        return *best, jnp.maximum(left[3], right[3])

    unit = (jnp.float64(jnp.inf), jnp.int32(_NO_KEY), jnp.int32(len(key)), jnp.int32(-1))
    return lax.reduce((distance, key, slot, place), unit, less, (0,))


def _augment(
    owner: Int[Array, "C"],
    previous: Int[Array, "C"],
    at_slot: Bool[Array, "C"],
    holder: Int[Array, ""],
    driver: Int[Array, ""],
    ends: Bool[Array, ""],
) -> Int[Array, "C"]:
    """Passes every slot of the path on to the driver before it, back to `driver`."""

    def unfinished(carry):
        return carry[0] != driver

    def pass_on(carry):
        holder, renewed = carry
        moves = holder != driver
        given_up = (owner == holder) & moves
        holder = jnp.where(moves, jnp.max(jnp.where(given_up, previous, -1)), holder)
        return holder, jnp.where(given_up, holder, renewed)

    holder = jnp.where(ends, holder, driver)
    renewed = jnp.where(at_slot & ends, holder, owner)
    return repeat(unfinished, pass_on, (holder, renewed))[1]


def _read_columns(
    slot: Int[Array, "N"],
    crossed: Bool[Array, "N"],
    object_of: Int[Array, "N"],
    groups: _Groups,
) -> Int[Array, "N"]:
    """Column of each row in the order of the caller; forbidden pairs are dropped."""
    num, columns = groups.allowed.shape
    index = jnp.arange(num, dtype=jnp.int32)
    taken = crossed[:, None] & (slot[:, None] == index[None, :])
    column = jnp.max(jnp.where(taken, object_of[:, None], NO_SLOT), axis=0)
    column = jnp.where(crossed, column, slot)
    picked = jnp.arange(columns, dtype=jnp.int32)[None, :] == column[:, None]
    fits = groups.live & jnp.any(picked & groups.allowed, axis=1)
    column = jnp.where(fits, column, NO_SLOT)
    here = groups.order[None, :] == index[:, None]
    return jnp.max(jnp.where(here, column[None, :], NO_SLOT), axis=1).astype(jnp.int32)
