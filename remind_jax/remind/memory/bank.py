"""What an observation does to the prototype banks of an object: the one rule of all channels.

An observation refreshes the prototype that it resembles, or founds one in the work bank
(method.md#banks, method.md#first-view). A work prototype that proved itself is promoted
(method.md#bank-promotion): as a whole or a ring, it moves to the stable bank; as a part or a patch
of a ring, it stays and feeds the stable bank. A full bank merges its closest pair, or gives up its
weakest prototype (method.md#bank-room). What differs between the channels is data: a `Channel`, see
`channels`.

Letters: `C` channels of a kind, `N` detections, `S` slots, `D` dimensions.
"""

from __future__ import annotations

import dataclasses
import functools

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from remind_jax.numerics.control_flow import branch
from remind_jax.numerics.pooling import to_unit
from remind_jax.remind.memory.prototypes import (
    Bank,
    DualBank,
    append,
    closest_pair,
    count_quality,
    entry,
    live,
    mean_quality,
    move_toward,
    nearest,
    new_entry,
    remove,
    similarities,
    similarity_rate,
    write,
)

_TIE = 1e-6
_FIRST = 0  # the entry that is longest in a bank


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Permit:
    """What an update may do to a bank (method.md#update-permit)."""

    insert: Bool[Array, ""]  # also merge and promote
    rate: Float[Array, ""]  # share of the step, [0, 1]


@dataclasses.dataclass(frozen=True)
class Refresh:
    """How a prototype of one of the two banks follows an observation that it resembles."""

    duplicate: Float[Array, ""]  # from this cosine on
    margin: Float[Array, ""]  # cosine above `duplicate` within which it does not move
    rate_min: Float[Array, ""]  # step at that margin
    rate_max: Float[Array, ""]  # step at cosine 1
    min_quality: Float[Array, ""] | float = 0.0  # least quality that moves it
    moves: Bool[Array, ""] | bool = True  # it moves at all
    by_quality: Bool[Array, ""] | bool = False  # the step is the quality, whatever the cosine


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Room:
    """How a full bank makes room; work and stable bank side by side."""

    capacity: Int[Array, "C 2"]  # prototypes per channel
    merge: Float[Array, "2"]  # the closest pair is joined from this cosine on
    redundant: Bool[Array, "2"]  # give up redundant prototypes, else the least recently seen
    cap: Int[Array, ""] | None  # weight of a joined prototype; None: equal weights


@dataclasses.dataclass(frozen=True)
class Channel:
    """All that differs between the channels."""

    work: Refresh
    stable: Refresh
    room: Room
    promote_hits: Int[Array, ""]  # hits that prove a work prototype
    promote_quality: Float[Array, ""] | float = 0.0  # least mean quality of a proven one
    promotes: Bool[Array, ""] | bool = True
    create_quality: Float[Array, ""] | float = 0.0  # least quality of what founds a prototype
    keeps_first: Bool[Array, ""] | bool = False  # in empty banks any quality will do
    refreshes_work: Bool[Array, ""] | bool = True  # a work duplicate counts
    novel: Float[Array, ""] | None = None  # nothing closer founds a prototype; None: anything may
    novel_when_full: bool = False  # that holds for a full work bank only
    stable_waits: bool = False  # nothing moves to a full stable bank
    one_to_one: Bool[Array, ""] | bool = False  # observations of one frame take different ones
    # A full stable bank gives up its first entry, and joins its closest pair from this cosine on.
    stable_merge: Float[Array, ""] | None = None


def observe_one(
    banks: DualBank,
    vector: Float[Array, "C N D"],
    present: Bool[Array, "C N"],
    quality: Float[Array, "C N"],
    permit: Permit,
    now: Int[Array, ""],
    channel: Channel,
) -> DualBank:
    """Shows one observation to each bank; proven work prototypes move to the stable bank.

    Args:
      banks: Work and stable banks, leading axes `[C N]`.
      vector: Unit descriptors.
      present: False leaves the banks as they are.
      quality: Observation quality, [0, 1].
      permit: What the update of each detection may do.
      now: Frame.
      channel: How the channel learns.
    """
    observe = functools.partial(_observe_one, now=now, c=channel)
    over_detections = jax.vmap(observe, in_axes=(0, 0, 0, 0, 0, None))
    banks, arrival = jax.vmap(over_detections, in_axes=(0, 0, 0, 0, None, 0))(
        banks, vector, present, quality, permit, channel.room.capacity[:, 1]
    )
    return place(banks, arrival, channel.room, now)


def _observe_one(
    banks: DualBank,
    vector: Float[Array, "D"],
    present: Bool[Array, ""],
    quality: Float[Array, ""],
    permit: Permit,
    stable_capacity: Int[Array, ""],
    now: Int[Array, ""],
    c: Channel,
) -> tuple[DualBank, Arrival]:
    """A stable duplicate hides the work bank; the banks, and what is to enter one of them."""
    stable_at, stable_cosine = nearest(banks.stable, vector)
    work_at, work_cosine = nearest(banks.work, vector)
    in_stable = present & (stable_cosine >= c.stable.duplicate)
    in_work = present & ~in_stable & (work_cosine >= c.work.duplicate)
    again = in_work & c.refreshes_work
    refresh = functools.partial(_refresh, vector=vector, quality=quality, permit=permit, now=now)
    stable = refresh(banks.stable, stable_at, stable_cosine, rule=c.stable, when=in_stable)
    work = refresh(banks.work, work_at, work_cosine, rule=c.work, when=again)

    moved = entry(work, work_at)
    proven = (moved.hits >= c.promote_hits) & (mean_quality(moved) >= c.promote_quality)
    leaves = again & permit.insert & c.promotes & proven
    twin, twin_cosine = nearest(stable, moved.embedding)
    joins = twin_cosine >= c.stable.duplicate
    if c.stable_waits:
        leaves = leaves & (joins | (stable.size < stable_capacity))
    joined = merge_entries(entry(stable, twin), moved, now, c.room.cap)
    stable = write(stable, twin, joined, leaves & joins)
    work = remove(work, work_at, leaves)

    empty = (banks.work.size == 0) & (banks.stable.size == 0)
    good = (quality >= c.create_quality) | (c.keeps_first & empty)
    founds = present & ~in_stable & ~in_work & permit.insert & good
    if c.novel is not None:
        founds = founds & (jnp.maximum(stable_cosine, work_cosine) <= c.novel)
    fresh = new_entry(vector, quality, now)
    value = jax.tree.map(lambda new, old: jnp.where(founds, new, old), fresh, moved)
    return DualBank(work, stable), Arrival(value, founds, leaves & ~joins)


def observe_several(
    banks: DualBank,
    vector: Float[Array, "K C N D"],
    present: Bool[Array, "K C N"],
    permit: Permit,
    now: Int[Array, ""],
    channel: Channel,
) -> DualBank:
    """Shows unrated observations to each bank in turn; proven work prototypes feed the stable bank.

    Args:
      banks: Work and stable banks, leading axes `[C N]`.
      vector: Unit descriptors.
      present: False leaves the banks as they are.
      permit: What the update of each detection may do.
      now: Frame.
      channel: How the channel learns.
    """
    observe = _observe_part if channel.stable_merge is None else _observe_patch

    def show(carry: tuple[DualBank, Array], one: tuple[Array, Array]):
        return observe(*carry, *one, permit, now, channel), None

    used = jnp.zeros(banks.work.hits.shape, bool)
    return jax.lax.scan(show, (banks, used), (vector, present))[0][0]


def _observe_part(
    banks: DualBank,
    used: Bool[Array, "C N S"],
    vector: Float[Array, "C N D"],
    present: Bool[Array, "C N"],
    permit: Permit,
    now: Int[Array, ""],
    c: Channel,
) -> tuple[DualBank, Bool[Array, "C N S"]]:
    """What a part refreshed feeds the stable bank if it is proven."""

    def meet(banks: DualBank, used: Array, vector: Array, present: Array, permit: Permit):
        work, used, at, again, founds = _meet(banks.work, used, vector, present, permit, now, c)
        proven = entry(work, at)
        feeds = again & permit.insert & c.promotes & (proven.hits >= c.promote_hits)
        stable, enters = _feed(banks.stable, proven, feeds, permit, now, c)
        value = _unrated(work, jnp.where(founds, vector, proven.embedding), now)
        return DualBank(work, stable), used, Arrival(value, founds, enters)

    banks, used, arrival = _over_banks(meet)(banks, used, vector, present, permit)
    return place(banks, arrival, c.room, now), used


def _observe_patch(
    banks: DualBank,
    used: Bool[Array, "C N S"],
    vector: Float[Array, "C N D"],
    present: Bool[Array, "C N"],
    permit: Permit,
    now: Int[Array, ""],
    c: Channel,
) -> tuple[DualBank, Bool[Array, "C N S"]]:
    """The work prototype nearest to a ring patch in the end feeds the stable bank if proven."""

    def meet(banks: DualBank, used: Array, vector: Array, present: Array, permit: Permit):
        work, used, _, _, founds = _meet(banks.work, used, vector, present, permit, now, c)
        value = _unrated(work, vector, now)
        return DualBank(work, banks.stable), used, Arrival(value, founds, jnp.zeros_like(founds))

    def feed(banks: DualBank, vector: Array, present: Array, permit: Permit):
        proven = entry(banks.work, nearest(banks.work, vector)[0])
        feeds = present & (banks.work.size > 0) & permit.insert & (proven.hits >= c.promote_hits)
        stable, enters = _feed(banks.stable, proven, feeds, permit, now, c)
        return stable, _unrated(stable, proven.embedding, now), enters

    def enter(bank: Bank, value: Bank, enters: Array, capacity: Array) -> Bank:
        bank = remove(bank, jnp.int32(_FIRST), enters & (bank.size >= capacity))
        return append(bank, value, enters)

    def join(bank: Bank, when: Array) -> Bank:
        cosine, i, j, _ = closest_pair(bank)
        joins = when & (cosine >= jnp.asarray(c.stable_merge))
        joined = merge_entries(entry(bank, i), entry(bank, j), now, c.room.cap)
        return remove(write(bank, i, joined, joins), j, joins)

    banks, used, arrival = _over_banks(meet)(banks, used, vector, present, permit)
    banks = place(banks, arrival, c.room, now)
    stable, value, enters = _over_banks(feed)(banks, vector, present, permit)
    stable = jax.vmap(jax.vmap(enter, (0, 0, 0, None)))(
        stable, value, enters, c.room.capacity[:, 1]
    )
    stable = branch(
        jnp.any(enters), lambda: jax.vmap(jax.vmap(join))(stable, enters), lambda: stable
    )
    return DualBank(banks.work, stable), used


def _over_banks(function):
    """Maps over channels and detections; what is permitted, the last argument, is per detection."""

    def mapped(*args):
        axes = (*(0 for _ in args[:-1]), None)
        return jax.vmap(jax.vmap(function), in_axes=axes)(*args)

    return mapped


def _meet(
    work: Bank,
    used: Bool[Array, "S"],
    vector: Float[Array, "D"],
    present: Bool[Array, ""],
    permit: Permit,
    now: Int[Array, ""],
    c: Channel,
) -> tuple[Bank, Bool[Array, "S"], Int[Array, ""], Bool[Array, ""], Bool[Array, ""]]:
    """Refreshes the most similar work prototype, if possible one that `used` does not mark.

    Returns:
      The work bank; which prototypes this detection refreshed; the most similar one; whether it was
      refreshed; and whether the vector founds one instead.
    """
    cosines = similarities(work, vector)
    best = jnp.argmax(cosines)
    free = jnp.where(used, -jnp.inf, cosines)
    other = jnp.argmax(free)
    redirect = c.one_to_one & used[best] & (work.size > 1) & jnp.isfinite(free[other])
    at = jnp.where(redirect, other, best)
    cosine = cosines[at]
    again = present & (cosine >= c.work.duplicate)
    work = _refresh(work, at, cosine, vector, None, permit, now, c.work, again)
    used = used | (again & (jnp.arange(used.shape[0]) == at))
    founds = present & ~again & permit.insert
    if c.novel is not None:
        room = work.size < c.room.capacity[0, 0] if c.novel_when_full else False
        founds = founds & (room | (cosine <= c.novel))
    return work, used, at, again, founds


def _feed(
    stable: Bank,
    proven: Bank,
    feeds: Bool[Array, ""],
    permit: Permit,
    now: Int[Array, ""],
    c: Channel,
) -> tuple[Bank, Bool[Array, ""]]:
    """Refreshes the twin of a proven prototype; without one, it is to enter the stable bank."""
    twin, cosine = nearest(stable, proven.embedding)
    known = cosine >= c.stable.duplicate
    vector = proven.embedding
    stable = _refresh(stable, twin, cosine, vector, None, permit, now, c.stable, feeds & known)
    return stable, feeds & ~known


def _refresh(
    bank: Bank,
    at: Int[Array, ""],
    cosine: Float[Array, ""],
    vector: Float[Array, "D"],
    quality: Float[Array, ""] | None,
    permit: Permit,
    now: Int[Array, ""],
    rule: Refresh,
    when: Bool[Array, ""],
) -> Bank:
    """Counts a hit and steps toward the vector; an unrated one has no quality to count."""
    old = entry(bank, at)
    scale = permit.rate if quality is None else permit.rate * quality
    rate = similarity_rate(cosine, rule.duplicate, rule.margin, rule.rate_min, rule.rate_max, scale)
    if quality is not None:
        rate = jnp.where(rule.by_quality, quality, rate)
        rate = jnp.where((quality >= rule.min_quality) & rule.moves, rate, 0.0)
        counted = count_quality(old, quality)
    else:
        rate, counted = jnp.where(rule.moves, rate, 0.0), old
    embedding = move_toward(old.embedding, vector, rate)
    new = dataclasses.replace(counted, embedding=embedding, hits=old.hits + 1, last_seen=now)
    return write(bank, at, new, when)


def _unrated(bank: Bank, vector: Float[Array, "D"], now: Int[Array, ""]) -> Bank:
    """The prototype that an observation without a quality founds."""
    return new_entry(vector, jnp.ones((), bank.quality_sum.dtype), now)


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Arrival:
    """A prototype that enters one of the two banks, or none; leading axes as those of the banks."""

    value: Bank
    to_work: Bool[Array, "..."]
    to_stable: Bool[Array, "..."]


def place(banks: DualBank, arrival: Arrival, room: Room, now: Int[Array, ""]) -> DualBank:
    """Adds the arrivals to their banks, leading axes `[C N]`, making room in full ones.

    Comparing all pairs of a bank costs far more than the rest of an update, so it is done for the
    batch as a whole and only if some bank needs it.
    """
    stable = arrival.to_stable

    def choose(in_work: Array, in_stable: Array) -> Array:
        extra = (1,) * (in_work.ndim - stable.ndim)
        return jnp.where(stable.reshape(*stable.shape, *extra), in_stable, in_work)

    bank_index = stable.astype(jnp.int32)
    capacity = jnp.take_along_axis(room.capacity, bank_index, axis=1)
    size = choose(banks.work.size, banks.stable.size)
    full = (arrival.to_work | stable) & (size >= capacity)

    def free_slots() -> DualBank:
        target = jax.tree.map(choose, banks.work, banks.stable)
        make = jax.vmap(jax.vmap(make_room, (0, 0, 0, 0, None, None)), (0, 0, 0, 0, None, None))
        freed = make(
            target, full, room.merge[bank_index], room.redundant[bank_index], room.cap, now
        )
        return DualBank(
            work=jax.tree.map(lambda old, new: choose(new, old), banks.work, freed),
            stable=jax.tree.map(choose, banks.stable, freed),
        )

    banks = branch(jnp.any(full), free_slots, lambda: banks)
    add = jax.vmap(jax.vmap(append))
    return DualBank(
        add(banks.work, arrival.value, arrival.to_work),
        add(banks.stable, arrival.value, arrival.to_stable),
    )


def make_room(
    bank: Bank,
    when: Bool[Array, ""],
    merge: Float[Array, ""],
    redundant: Bool[Array, ""],
    cap: Int[Array, ""] | None,
    now: Int[Array, ""],
) -> Bank:
    """Frees one slot if `when` holds: joins the closest pair, or gives up the weakest prototype."""
    cosine, i, j, all_cosines = closest_pair(bank)
    joins = cosine >= merge
    bank = write(bank, i, merge_entries(entry(bank, i), entry(bank, j), now, cap), when & joins)
    return remove(bank, jnp.where(joins, j, weakest(bank, all_cosines, redundant)), when)


def weakest(bank: Bank, cosine: Float[Array, "S S"], redundant: Bool[Array, ""]) -> Int[Array, ""]:
    """The prototype to give up: the least recently seen of all, or of the most redundant ones.

    method.md#bank-room; the first among equals.
    """
    alive = live(bank)
    others = jnp.where(jnp.eye(alive.shape[0], dtype=bool), -1.0, cosine)
    redundancy = jnp.max(others, axis=1)
    redundancy = jnp.where(redundancy > -1.0, redundancy, 0.0)
    top = jnp.max(jnp.where(alive, redundancy, -jnp.inf))
    alive = alive & (~redundant | (jnp.abs(redundancy - top) < _TIE))
    return jnp.argmin(jnp.where(alive, bank.last_seen, jnp.iinfo(jnp.int32).max))


def merge_entries(left: Bank, right: Bank, now: Int[Array, ""], cap: Int[Array, ""] | None) -> Bank:
    """Joins two prototypes; weights are equal, or the hits up to `cap`.

    Rule: method.md#prototype-merge.
    """
    weights = [1.0, 1.0]
    if cap is not None:
        weights = [
            jnp.minimum(side.hits, jnp.maximum(1, cap)).astype(jnp.float32)
            for side in (left, right)
        ]
    joined = Bank(
        embedding=to_unit(weights[0] * left.embedding + weights[1] * right.embedding),
        hits=left.hits + right.hits,
        last_seen=jnp.maximum(jnp.maximum(left.last_seen, right.last_seen), now),
        quality_recent=left.quality_recent,
        quality_sum=left.quality_sum + right.quality_sum,
        num_qualities=left.num_qualities + right.num_qualities,
        size=left.size,
    )
    return dataclasses.replace(joined, quality_recent=mean_quality(joined))
