"""What an observation does to the prototype banks of an object: the one rule of all channels.

An observation refreshes the prototype that it resembles, or founds one in the work bank
(method.md#banks, method.md#first-view). A work prototype that proved itself is promoted
(method.md#bank-promotion): as a whole or a ring, it moves to the stable bank; as a part or a patch
of a ring, it stays and feeds the stable bank. A full bank merges its closest pair, or gives up its
weakest prototype (method.md#bank-room). What differs between the channels is data: a `Channel`, see
`channels`.

An observation changes each bank by at most one `Edit`, which is found in the banks as they were.

Letters: `C` channels of a kind, `N` detections, `S` slots, `D` dimensions; the axis of two is that
of the banks, work and stable.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from remind_jax.numerics.columns import columns
from remind_jax.numerics.control_flow import branch
from remind_jax.numerics.pytree import choose, pytree
from remind_jax.numerics.ranks import largest
from remind_jax.numerics.rounding import divide
from remind_jax.remind.memory.bank_room import make_room, merge_entries
from remind_jax.remind.memory.prototypes import (
    STABLE,
    WORK,
    Bank,
    Edit,
    change,
    change_all,
    closest_pair,
    count,
    count_quality,
    entry,
    mean_quality,
    move_toward,
    nearest,
    new_entry,
    similarities,
)

_FIRST = 0  # the entry that is longest in a bank


@pytree
class Permit:
    """What an update may do to a bank (method.md#update-permit)."""

    insert: Bool[Array, ""]  # also merge and promote
    rate: Float[Array, ""]  # share of the step, [0, 1]


@pytree
class Observation:
    """One observation that is shown to the two banks of an object; many with leading axes."""

    vector: Float[Array, "... D"]  # unit descriptor
    present: Bool[Array, "..."]  # False leaves the banks as they are
    quality: Float[Array, "..."] | None  # [0, 1]; None for a part
    permit: Permit  # what the update may do


@pytree
class Refresh:
    """How a prototype follows an observation that it resembles."""

    duplicate: Any  # from this cosine on
    margin: Any  # cosine above `duplicate` within which it does not move
    rate_min: Any  # step at that margin
    rate_max: Any  # step at cosine 1
    min_quality: Any = (0.0, 0.0)  # least quality that moves it
    moves: Any = (True, True)  # it moves at all
    by_quality: Any = (False, False)  # the step is the quality, whatever the cosine


@pytree
class Room:
    """How a full bank makes room."""

    capacity: Any  # prototypes
    merge: Any  # the closest pair is joined from this cosine on
    redundant: Any  # give up redundant prototypes, else the least recently seen


@pytree
class Channel:
    """All that differs between the channels: numbers and flags, or pairs for work and stable bank.

    `side_by_side` makes one of several channels, with arrays `[C]`, or `[C 2]` for pairs.
    """

    refresh: Refresh  # pairs
    room: Room  # pairs
    cap: Any  # largest weight of a prototype that is joined; 1: equal weights
    promote_hits: Any  # hits that prove a work prototype
    promote_quality: Any = 0.0  # least mean quality of a proven one
    promotes: Any = True
    create_quality: Any = 0.0  # least quality of what founds a prototype
    keeps_first: Any = False  # in empty banks any quality will do
    refreshes_work: Any = True  # a work duplicate counts
    novel: Any = jnp.inf  # nothing closer founds a prototype; for parts in a full work bank only
    stable_waits: Any = False  # nothing moves to a full stable bank
    one_to_one: Any = False  # observations of one frame take different prototypes


def side_by_side(*channels: Channel) -> Channel:
    """The channels of a kind as arrays."""

    def join(*values: Any) -> Array:
        pairs = (columns(*value) if isinstance(value, tuple) else value for value in values)
        return jnp.moveaxis(columns(*pairs), -1, 0)

    return jax.tree.map(join, *channels, is_leaf=lambda node: isinstance(node, tuple))


def observe_whole(banks: Bank, seen: Observation, now: Int[Array, ""], channel: Channel) -> Bank:
    """Shows one rated observation `[C N]` to each bank `[2 C N]`; the proven become stable."""
    unused = jnp.zeros((*seen.present.shape, banks.embedding.shape[-2]), bool)
    return _observe(banks, unused, seen, now, channel)[0]


def observe_several(
    banks: Bank,
    vector: Float[Array, "K C N D"],
    present: Bool[Array, "K C N"],
    permit: Permit,
    now: Int[Array, ""],
    channels: Sequence[Channel],
    patch_merge: Float[Array, ""] | None = None,
) -> Bank:
    """Shows unrated observations in turn to each bank `[2 C N]`; proven ones feed the stable bank.

    Patches of a ring join the closest pair of a stable bank from the cosine `patch_merge` on.
    """

    def show(carry: tuple[Bank, Array], one: tuple[Array, Array]):
        # Joined here, for what enters a loop from outside is written down.
        channel = side_by_side(*channels)
        if patch_merge is not None:
            feeds_later = jnp.zeros_like(channel.promotes)
            channel = dataclasses.replace(channel, promotes=feeds_later)
        seen = Observation(*one, None, permit)
        banks, used = _observe(*carry, seen, now, channel)
        if patch_merge is not None:
            banks = _feed_patches(banks, seen, now, channel, patch_merge)
        return (banks, used), None

    used = jnp.zeros((*present.shape[1:], banks.embedding.shape[-2]), bool)
    return jax.lax.scan(show, (banks, used), (vector, present))[0][0]


# Axis of the detections and of the channels of what is mapped.
_BANKS, _ROWS = (1, 1), (0, 0)
_OBSERVATIONS = (Observation(*[0] * 4), Observation(0, 0, 0, None))  # pyright: ignore[reportArgumentType]


def _observe(
    banks: Bank,
    used: Bool[Array, "C N S"],
    seen: Observation,
    now: Int[Array, ""],
    channel: Channel,
) -> tuple[Bank, Bool[Array, "C N S"]]:
    """Shows one observation to each bank, and makes room where one is full.

    Comparing all pairs of a bank costs far more than the rest of an update, so it is done for the
    batch as a whole and only if some bank needs it.
    """
    # Cosines are found for all banks at once, between the two halves of what is mapped.
    given = [_ROWS, _OBSERVATIONS, (None, 0)]  # `used`, `seen`, `channel`
    meet = _over_banks(functools.partial(_meet, now=now), [_BANKS, _BANKS, *given], 0)
    met = meet(banks, similarities(banks, seen.vector), used, seen, channel)
    moved = met.refreshed.embedding[:, :, WORK]
    judge = _over_banks(
        functools.partial(_judge, now=now), [_BANKS, _ROWS, _ROWS, *given], (1, 0, 1, 0)
    )
    twins = similarities(banks, moved)[STABLE]
    edit, arrival, adds, used = judge(banks, met, twins, used, seen, channel)
    full = adds & (banks.size >= channel.room.capacity.T[..., None])

    def find_room() -> Edit:
        is_stable = full[STABLE]
        target = choose(is_stable, banks.stable, banks.work)
        of_channel = lambda pairs: jnp.where(is_stable, pairs[:, 1:], pairs[:, :1])  # noqa: E731
        make = functools.partial(make_room, now=now)
        return jax.vmap(jax.vmap(make, (0, 0, 0, None)))(
            target, of_channel(channel.room.merge), of_channel(channel.room.redundant), channel.cap
        )

    no_room = jax.tree.map(lambda leaf: jnp.zeros(leaf.shape[1:], leaf.dtype), edit)
    freed = branch(jnp.any(full), find_room, lambda: no_room, suits_all=True)
    return change_all(banks, choose(full, freed, edit), arrival, adds), used


def _over_banks(function: Callable, axes: Sequence[tuple], out_axes: Any) -> Callable:
    """Maps over the detections, then over the channels."""
    of_detections, of_channels = zip(*axes, strict=True)
    return jax.vmap(jax.vmap(function, of_detections, out_axes), of_channels, out_axes)


@pytree
class _Met:
    """The prototypes that one observation resembles, in the work and in the stable bank."""

    at: Int[Array, "2"]
    cosine: Float[Array, "2"]
    in_stable: Bool[Array, ""]  # a duplicate of the stable one
    in_work: Bool[Array, ""]  # of the work prototype, unless the stable one hides it
    refreshed: Bank  # both, moved toward the observation


def _meet(
    banks: Bank,
    cosines: Float[Array, "2 S"],
    used: Bool[Array, "S"],
    seen: Observation,
    c: Channel,
    *,
    now: Int[Array, ""],
) -> _Met:
    """Finds what one observation, rated or a part, resembles in the two banks of an object."""
    cosine, at = largest(cosines)
    if seen.quality is None:
        free = jnp.where(used, -jnp.inf, cosines[WORK])
        redirect = c.one_to_one & used[at[WORK]] & (banks.size[WORK] > 1)
        other_cosine, other = largest(free)
        redirect = redirect & jnp.isfinite(other_cosine)
        at = columns(jnp.where(redirect, other, at[WORK]), at[STABLE])
        cosine = columns(jnp.where(redirect, other_cosine, cosine[WORK]), cosine[STABLE])
    old = jax.vmap(entry)(banks, at)
    close = seen.present & (cosine >= c.refresh.duplicate)
    # A stable duplicate hides the work bank from the whole, but not from parts.
    in_stable = jnp.zeros_like(seen.present) if seen.quality is None else close[STABLE]
    refreshed = jax.vmap(functools.partial(_refresh, seen, now))(old, cosine, c.refresh)
    return _Met(at, cosine, in_stable, close[WORK] & ~in_stable, refreshed)


def _judge(
    banks: Bank,
    met: _Met,
    twins: Float[Array, "S"],
    used: Bool[Array, "S"],
    seen: Observation,
    c: Channel,
    *,
    now: Int[Array, ""],
) -> tuple[Edit, Bank, Bool[Array, "2"], Bool[Array, "S"]]:
    """What the observation means to the two banks.

    Args:
      twins: Cosines of the work prototype, as moved, with those of the stable bank.
      used: Work prototypes that this detection refreshed.

    Returns:
      The edit of each bank; what is to enter one of them, and which; and the work prototypes that
      this detection refreshed. A bank that something enters is not edited otherwise.
    """
    vector, quality, permit = seen.vector, seen.quality, seen.permit
    one = jnp.ones((), banks.qualities.dtype)
    at, in_stable, in_work = met.at, met.in_stable, met.in_work
    again = in_work & c.refreshes_work
    moved = met.refreshed.work
    proven = again & permit.insert & c.promotes & (moved.hits >= c.promote_hits)
    twin_cosine, twin = largest(twins)
    known = twin_cosine >= c.refresh.duplicate[STABLE]
    in_twin = entry(banks.stable, twin)
    founds = seen.present & ~in_stable & ~in_work & permit.insert
    leaves = jnp.zeros_like(proven)
    if quality is None:
        joined = _feed(in_twin, twin_cosine, moved, permit, c, now)
        has_room = banks.size[WORK] < c.room.capacity[WORK]
        founds = founds & (has_room | (met.cosine[WORK] <= c.novel))
        arrival = new_entry(jnp.where(founds, vector, moved.embedding), one, now)
    else:
        joined = merge_entries(in_twin, moved, now, c.cap)
        waits = c.stable_waits & ~known & (banks.size[STABLE] >= c.room.capacity[STABLE])
        proven = proven & (mean_quality(moved) >= c.promote_quality) & ~waits
        good = (quality >= c.create_quality) | (c.keeps_first & jnp.all(banks.size == 0))
        founds = founds & good & (jnp.max(met.cosine) <= c.novel)
        arrival = choose(founds, new_entry(vector, quality, now), moved)
        leaves = proven
    edit = Edit(
        at=columns(at[WORK], jnp.where(in_stable, at[STABLE], twin)),
        value=jax.tree.map(
            lambda *leaves: jnp.stack(leaves),
            moved,
            choose(in_stable, met.refreshed.stable, joined),
        ),
        replaces=columns(again & ~leaves, in_stable | (proven & known)),
        gone=at,
        removes=columns(leaves, jnp.zeros_like(leaves)),
    )
    used = used | (again & (jnp.arange(used.shape[0]) == at[WORK]))
    return edit, arrival, columns(founds, proven & ~known), used


def _feed_patches(
    banks: Bank, seen: Observation, now: Array, channel: Channel, patch_merge: Float[Array, ""]
) -> Bank:
    """The work prototype nearest to a ring patch in the end feeds the stable bank if proven.

    A full stable bank gives up its first entry, and joins its closest pair after what enters.
    """

    def feed(banks: Bank, seen: Observation, c: Channel) -> tuple[Bank, Array]:
        work, stable, permit = banks.work, banks.stable, seen.permit
        proven = entry(work, nearest(work, seen.vector)[0])
        feeds = seen.present & (work.size > 0) & permit.insert & (proven.hits >= c.promote_hits)
        twin, cosine = nearest(stable, proven.embedding)
        known = cosine >= c.refresh.duplicate[STABLE]
        value = _feed(entry(stable, twin), cosine, proven, permit, c, now)
        enters = feeds & ~known
        full = enters & (stable.size >= c.room.capacity[STABLE])
        edit = Edit(twin, value, feeds & known, jnp.int32(_FIRST), full)
        fresh = new_entry(proven.embedding, jnp.ones((), stable.qualities.dtype), now)
        return change(stable, edit, fresh, enters), enters

    def join(bank: Bank, when: Array, cap: Array) -> Bank:
        cosine, i, j, _ = closest_pair(bank)
        joins = when & (cosine >= patch_merge)
        joined = merge_entries(entry(bank, i), entry(bank, j), now, cap)
        return change(bank, Edit(i, joined, joins, j, joins), joined, jnp.zeros_like(joins))

    fed = _over_banks(feed, [_BANKS, _OBSERVATIONS, (None, 0)], 0)
    stable, enters = fed(banks, seen, channel)
    stable = branch(
        jnp.any(enters),
        lambda: jax.vmap(jax.vmap(join, (0, 0, None)))(stable, enters, channel.cap),
        lambda: stable,
        suits_all=True,
    )
    return jax.tree.map(lambda *sides: jnp.stack(sides), banks.work, stable)


def _feed(
    old: Bank, cosine: Float[Array, ""], proven: Bank, permit: Permit, c: Channel, now: Array
) -> Bank:
    """A stable prototype that a work prototype, proven by unrated observations, resembles."""
    rule = jax.tree.map(lambda pair: pair[STABLE], c.refresh)
    seen = Observation(proven.embedding, jnp.bool_(True), None, permit)
    return _refresh(seen, now, old, cosine, rule)


def _refresh(
    seen: Observation, now: Int[Array, ""], old: Bank, cosine: Float[Array, ""], rule: Refresh
) -> Bank:
    """Counts a hit and steps toward the vector; an unrated one has no quality to count."""
    vector, quality, permit = seen.vector, seen.quality, seen.permit
    scale = permit.rate if quality is None else permit.rate * quality
    rate = _step(cosine, rule, scale)
    counted = old
    if quality is not None:
        rate = jnp.where(rule.by_quality, quality, rate)
        rate = jnp.where(quality >= rule.min_quality, rate, 0.0)
        counted = count_quality(old, quality)
    rate = jnp.where(rule.moves, rate, 0.0)
    return dataclasses.replace(
        counted,
        embedding=move_toward(old.embedding, vector, rate),
        counts=count(old.hits + 1, now, counted.num_qualities),
    )


def _step(cosine: Float[Array, ""], rule: Refresh, scale: Float[Array, ""]) -> Float[Array, ""]:
    """Step by similarity: none in the margin, then low to high (method.md#similarity-step)."""
    low, high = jnp.clip(rule.rate_min, 0.0, 1.0), jnp.clip(rule.rate_max, 0.0, 1.0)
    low, high = jnp.minimum(low, high), jnp.maximum(low, high)
    gate = rule.duplicate + rule.margin
    ramp = jnp.clip(divide(cosine - gate, jnp.maximum(1e-6, 1.0 - gate)), 0.0, 1.0)
    rate = (low + (high - low) * ramp) * jnp.clip(scale, 0.0, 1.0)
    return jnp.where(cosine < gate, 0.0, rate)
