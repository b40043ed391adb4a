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
import numpy as np
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from remind_jax.numerics.absent import NO_SLOT
from remind_jax.numerics.control_flow import branch, repeat
from remind_jax.numerics.ranks import count_before, largest, rank_rising

FORBIDDEN_COST = 1e6
_NO_KEY = 2**31 - 1
# Of each row the first position of its group, of each position its row, and what ends the drivers.
_START, _ROW, _END = 0, 1, 2


class _Problem(NamedTuple):
    """What the search reads; drivers are counted in the order in which they enter."""

    cost: Float[Array, "N C"]  # of each row as a driver in each slot
    place: Int[Array, "N C"]  # of the slot among the open ones, by rising order; -1: not open
    order: Int[Array, "3 N"]  # that of `_Groups`

    @property
    def num_drivers(self) -> Int[Array, ""]:
        return -self.order[_END, 0]


class _Search(NamedTuple):
    """State between two turns: three arrays, for each is a step to write; float64 holds all."""

    at: Float[Array, "5"]  # `_At`
    slots: Float[Array, "5 C"]  # `_Slots`
    drivers: Float[Array, "3 N"]  # `_Drivers`


class _At(NamedTuple):
    """Where the search is; `driver` looks for the cheapest path to a slot without owner."""

    driver: Int[Array, ""]
    visited: Int[Array, ""]  # driver whose slots are looked at next, on the path of `driver`
    holder: Int[Array, ""]  # driver that gives up its slot next, -1: the path is not found yet
    taken: Int[Array, ""]  # the slot that it took instead
    low: Float[Array, ""]  # length of the path to `visited`

    @classmethod
    def of(cls, state: _Search) -> _At:
        wholes = state.at[:4].astype(jnp.int32)
        return cls(*wholes, low=state.at[4])


class _Slots(NamedTuple):
    distance: Float[Array, "C"]  # length of the shortest path to each
    price: Float[Array, "C"]
    place: Int[Array, "C"]
    previous: Int[Array, "C"]  # last driver on the path
    owner: Int[Array, "C"]

    @classmethod
    def of(cls, state: _Search) -> _Slots:
        return cls(*state.slots[:2], *state.slots[2:].astype(jnp.int32))


class _Drivers(NamedTuple):
    entry: Float[Array, "N"]  # `low` when the driver was visited, inf: not visited
    price: Float[Array, "N"]
    settled: Int[Array, "N"]  # slot of drivers whose slot was taken over by a later group

    @classmethod
    def of(cls, state: _Search) -> _Drivers:
        entry, price, settled = state.drivers
        return cls(entry, price, settled.astype(jnp.int32))


def _join(values: tuple[Array, ...]) -> Array:
    return jnp.stack([value.astype(jnp.float64) for value in values])


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
    slot_index = jnp.arange(len(owner), dtype=jnp.int32)[None]
    slot = jnp.max(jnp.where(owner[None] == groups.position[:, None], slot_index, -1), axis=1)
    taken_over = settled[groups.position]
    slot = jnp.where(taken_over >= 0, taken_over, slot)
    return _read_columns(slot, crossed, object_of, groups, allowed)


def double_precision() -> AbstractContextManager[Any]:
    """Lets float64 be used inside a traced function without the global switch."""
    return jax.enable_x64(True)


class _Groups(NamedTuple):
    position: Int[Array, "N"]  # of each row by group, those that take no part last
    live: Bool[Array, "N"]
    same: Bool[Array, "N N"]  # both live and of one group
    order: Int[Array, "3 N"]  # `_START`, `_ROW`, `_END`
    columns: Bool[Array, "N M"]  # columns that the group of the row may use


def _sort_groups(
    allowed: Bool[Array, "N M"],
    present: Bool[Array, "N M"],
    group: Int[Array, "N"],
    dummies: Bool[Array, ""],
) -> _Groups:
    """Finds the rows that compete; one without allowed pair does so only where dummies do not."""
    active = jnp.any(allowed, axis=1)
    alike = group[:, None] == group[None, :]
    live = jnp.where(dummies, active, jnp.any(alike & active[None, :], axis=1))
    position = rank_rising([~live, group])
    same = alike & live[:, None] & live[None, :]
    index = jnp.arange(len(group), dtype=jnp.int32)
    # Three questions to all pairs of rows in one reduction.
    asked = [
        jnp.where(same, position[None], len(group)),
        jnp.where(position[None] == index[:, None], index[None], len(group)),
        jnp.broadcast_to(jnp.where(live, -1 - position, 0)[None], same.shape),
    ]
    order = jnp.min(jnp.stack(asked), axis=2)
    reach = jnp.dot(same.astype(jnp.float32), present.astype(jnp.float32))
    return _Groups(position, live, same, order, reach > 0)


def _pose(
    cost: Float[Array, "N M"], groups: _Groups, dummy_cost: Float[Array, "N"], dummies: Array
) -> tuple[_Problem, Bool[Array, "N"], Int[Array, "N"]]:
    """Lays out drivers and slots; also says which drivers are objects, and which objects."""
    num, columns = cost.shape
    slots = max(columns + 1, num)
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
    return _Problem(priced, place, groups.order), crossed, object_of


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
    rank = count_before(groups.columns)
    drives = groups.columns & (rank == (groups.position - groups.order[_START])[:, None])
    object_of = largest(drives)[1]
    competes = groups.same & jnp.any(drives, axis=1, keepdims=True)
    padding = ((0, 0), (0, slots - num))
    falling = num - jnp.arange(num, dtype=jnp.int32)
    turned = jnp.where(competes, falling[None, :], -1)
    turned = jnp.pad(turned, padding, constant_values=-1)
    priced = jnp.where(crossed[:, None], jnp.pad(cost[:, object_of].T, padding), priced)
    return crossed, object_of, priced, jnp.where(crossed[:, None], turned, place)


def _search(
    problem: _Problem, dummies: Bool[Array, ""], dummy_slot: int
) -> tuple[Int[Array, "C"], Int[Array, "N"]]:
    """Gives each driver in turn a slot by a shortest augmenting path.

    Returns the driver of each slot, and the slot of drivers that lost it to one of a later group.
    """
    with double_precision():
        cost = problem.cost.astype(jnp.float64)
        return _search_in_double(problem._replace(cost=cost), dummies, dummy_slot)


def _search_in_double(problem, dummies, dummy_slot):
    num, slots = problem.cost.shape
    per_slot, per_driver = jnp.zeros(slots, jnp.float64), jnp.zeros(num, jnp.float64)
    state = _Search(
        at=jnp.array([0, 0, -1, 0, 0], jnp.float64),
        slots=_join(_Slots(per_slot, per_slot, per_slot - 1, per_slot - 1, per_slot - 1)),
        drivers=_join(_Drivers(per_driver, per_driver, per_driver - 1)),
    )
    no_owner = dummies & (np.arange(slots) == dummy_slot)
    state = repeat(
        lambda state: _At.of(state).driver < problem.num_drivers,
        lambda state: _advance(state, problem, no_owner),
        state,
    )
    return _Slots.of(state).owner, _Drivers.of(state).settled


def _advance(state: _Search, problem: _Problem, no_owner: Bool[Array, "C"]) -> _Search:
    """Visits the next driver of a path, or passes on the next slot of a path that is found."""
    passed, visited = _pass_on(state), _visit(state, problem, no_owner)
    passes = _At.of(state).holder >= 0
    return _Search(*(jnp.where(passes, *leaves) for leaves in zip(passed, visited, strict=True)))


def _visit(state: _Search, problem: _Problem, no_owner: Bool[Array, "C"]) -> _Search:
    """Measures the open slots from one driver, closes the nearest, and ends or goes on there."""
    num, slots = problem.cost.shape
    slot_index, driver_index = (jnp.arange(size, dtype=jnp.int32) for size in (slots, num))
    driver, visited, _, _, low = _At.of(state)
    distance, slot_price, place, previous, owner = _Slots.of(state)
    entry, driver_price, settled = _Drivers.of(state)

    fresh = driver == visited
    low = jnp.where(fresh, 0.0, low)
    # Entries of a batch that are done wait for the others: without an open slot nothing changes.
    row = problem.order[_ROW, driver]
    todo = jnp.where(driver < problem.num_drivers, problem.place[row], -1)
    place = jnp.where(fresh, todo, place)
    entry = jnp.where(fresh, jnp.inf, entry)
    entry = jnp.where(driver_index == visited, low, entry)
    owned = owner >= problem.order[_START, row]
    slot_price = jnp.where(owned, slot_price, 0.0)

    is_open = place >= 0
    length = low + problem.cost[problem.order[_ROW, visited]] - driver_price[visited] - slot_price
    distance = jnp.where(fresh, jnp.inf, distance)
    shorter = is_open & (length < distance)
    distance = jnp.where(shorter, length, distance)
    previous = jnp.where(shorter, visited, previous)

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
    priced = jnp.where(entry < jnp.inf, driver_price + (low - entry), driver_price)
    holder, last_owner = previous[slot], owner[slot]
    gains = ends & found
    passes = gains & (holder != driver)
    after = driver + jnp.where(ends & ~passes, 1, 0)
    at = _At(
        driver=after,
        visited=jnp.where(ends, after, last_owner),
        holder=jnp.where(passes, holder, -1),
        taken=slot,
        low=low,
    )
    owner = jnp.where(at_slot & gains & ~no_owner, holder, owner)
    price = jnp.where(gains, paid, slot_price)
    driver_price = jnp.where(gains, priced, driver_price)
    settled = jnp.where(gains & (driver_index == last_owner), slot, settled)
    return _Search(
        at=_join(at),
        slots=_join(_Slots(distance, price, place, previous, owner)),
        drivers=_join(_Drivers(entry, driver_price, settled)),
    )


def _pass_on(state: _Search) -> _Search:
    """Gives the slot of a driver that took another one to the driver before it on the path."""
    driver, visited, holder, taken, low = _At.of(state)
    slots = _Slots.of(state)
    previous, owner = slots.previous, slots.owner
    slot_index = jnp.arange(len(owner), dtype=jnp.int32)
    given_up = (owner == holder) & (slot_index != taken)
    slot = jnp.max(jnp.where(given_up, slot_index, 0))
    heir = previous[slot]
    ends = heir == driver
    after = driver + jnp.where(ends, 1, 0)
    at = _At(after, jnp.where(ends, after, visited), jnp.where(ends, -1, heir), slot, low)
    owner = jnp.where(slot_index == slot, heir, owner)  # a driver gives up one slot
    return state._replace(at=_join(at), slots=_join(slots._replace(owner=owner)))


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


def _read_columns(
    slot: Int[Array, "N"],
    crossed: Bool[Array, "N"],
    object_of: Int[Array, "N"],
    groups: _Groups,
    allowed: Bool[Array, "N M"],
) -> Int[Array, "N"]:
    """Column of each row; forbidden pairs are dropped."""
    num, columns = allowed.shape
    row = jnp.arange(num, dtype=jnp.int32)
    taken = crossed[:, None] & (slot[:, None] == row[None, :])
    column = jnp.max(jnp.where(taken, object_of[:, None], NO_SLOT), axis=0)
    column = jnp.where(crossed, column, slot)
    fits = jnp.any(allowed & (column[:, None] == np.arange(columns)[None]), axis=1)
    return jnp.where(fits & groups.live, column, NO_SLOT).astype(jnp.int32)
