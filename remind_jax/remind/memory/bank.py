"""The one prototype bank of all channels: ordered slots, work and stable (paper III-C, III-F).

A bank is an ordered list in fixed slots: the first `size` are live, removal shifts the later ones
down, so that every rule "first among equals" means the older entry. Functions take one bank; map
them over objects with `jax.vmap`. Letters: `S` slots, `D` dimensions.
"""

from __future__ import annotations

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from remind_jax.decision import NEVER
from remind_jax.numerics.constant_arrays import full, zeros
from remind_jax.numerics.control_flow import branch
from remind_jax.numerics.pooling import dot, to_unit

_QUALITY_RATE_MIN, _QUALITY_RATE_MAX = 0.08, 0.30
_TIE = 1e-6


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Bank:
    """Prototypes of one kind, oldest first; leading axes are objects and channels."""

    embedding: Float[Array, "... S D"]  # unit vectors, float32
    hits: Int[Array, "... S"]  # observations that agreed
    last_seen: Int[Array, "... S"]  # frame
    quality_recent: Float[Array, "... S"]  # exponential mean of the observation quality, [0, 1]
    quality_sum: Float[Array, "... S"]  # sum of the observation qualities
    num_qualities: Int[Array, "... S"]  # number of qualities in the sum
    size: Int[Array, "..."]  # live slots


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class DualBank:
    """Fresh prototypes, and those that proved themselves."""

    work: Bank
    stable: Bank


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Permit:
    """What an update may do to a bank (method.md#update-permit)."""

    insert: Bool[Array, ""]  # also merge and promote
    rate: Float[Array, ""]  # share of the step, [0, 1]


def empty_bank(leading: tuple[int, ...], slots: int, dim: int, scalar: jnp.dtype) -> Bank:
    """A bank without prototypes for each entry of the leading axes."""
    shape = (*leading, slots)
    return Bank(
        embedding=zeros((*shape, dim), np.float32),
        hits=zeros(shape, np.int32),
        last_seen=full(shape, NEVER, np.int32),
        quality_recent=zeros(shape, scalar),
        quality_sum=zeros(shape, scalar),
        num_qualities=zeros(shape, np.int32),
        size=zeros(leading, np.int32),
    )


def live(bank: Bank) -> Bool[Array, "... S"]:
    """Slots that hold a prototype."""
    return jnp.arange(bank.hits.shape[-1]) < bank.size[..., None]


def mean_quality(bank: Bank) -> Float[Array, "... S"]:
    """Mean observation quality of each prototype, [0, 1] (method.md#prototype-quality)."""
    return jnp.clip(bank.quality_sum / jnp.maximum(1, bank.num_qualities), 0.0, 1.0)


def confidence(bank: Bank, promote_hits: Int[Array, ""]) -> Float[Array, "... S"]:
    """How far each prototype has proved itself, [0, 1] (method.md#prototype-quality)."""
    needed = jnp.where(promote_hits > 0, promote_hits, 4)
    share = jnp.minimum(1.0, bank.hits / needed.astype(bank.quality_sum.dtype))
    return jnp.clip(share * jnp.maximum(mean_quality(bank), bank.quality_recent), 0.0, 1.0)


def nearest(bank: Bank, vector: Float[Array, "D"]) -> tuple[Int[Array, ""], Float[Array, ""]]:
    """The most similar prototype and its cosine, -inf for an empty bank (method.md#banks)."""
    similarity = similarities(bank, vector)
    index = jnp.argmax(similarity)
    return index, similarity[index]


def similarities(bank: Bank, vector: Float[Array, "D"]) -> Float[Array, "S"]:
    """Cosine of a unit vector with every prototype, -inf in free slots."""
    cosine = dot(vector[None], bank.embedding)[0].astype(bank.quality_sum.dtype)
    return jnp.where(live(bank), cosine, -jnp.inf)


def entry(bank: Bank, index: Int[Array, ""]) -> Bank:
    """One prototype as a bank without the slot axis."""
    return jax.tree.map(lambda leaf: leaf[index] if leaf.ndim else leaf, bank)


def new_entry(vector: Float[Array, "D"], quality: Float[Array, ""], now: Int[Array, ""]) -> Bank:
    """The prototype that one observation founds."""
    one = jnp.int32(1)
    return Bank(vector, one, now.astype(jnp.int32), quality, quality, one, one)


def write(bank: Bank, index: Int[Array, ""], value: Bank, when: Bool[Array, ""]) -> Bank:
    """Replaces one prototype if `when` holds; the size stays."""
    chosen = (jnp.arange(bank.hits.shape[-1]) == index) & when
    return _blend(chosen, jax.tree.map(lambda leaf: leaf[None], value), bank)


def append(bank: Bank, value: Bank, when: Bool[Array, ""]) -> Bank:
    """Adds a prototype at the end if `when` holds; the caller made room."""
    bank = write(bank, bank.size, value, when)
    return dataclasses.replace(bank, size=bank.size + when.astype(jnp.int32))


def remove(bank: Bank, index: Int[Array, ""], when: Bool[Array, ""]) -> Bank:
    """Takes a prototype out if `when` holds and closes the gap."""
    later = (jnp.arange(bank.hits.shape[-1]) >= index) & when
    moved = jax.tree.map(lambda leaf: jnp.roll(leaf, -1, axis=0) if leaf.ndim else leaf, bank)
    bank = _blend(later, moved, bank)
    return dataclasses.replace(bank, size=bank.size - when.astype(jnp.int32))


def _blend(chosen: Bool[Array, "S"], new: Bank, old: Bank) -> Bank:
    """Slots of `new` where chosen, else of `old`; the size of `old`.

    A select over all slots fuses with its neighbours, where a scatter would not.
    """

    def pick(fresh: Array, kept: Array) -> Array:
        if not kept.ndim:
            return kept
        return jnp.where(chosen.reshape(-1, *(1,) * (kept.ndim - 1)), fresh, kept)

    return jax.tree.map(pick, new, old)


def count_quality(value: Bank, quality: Float[Array, ""]) -> Bank:
    """Adds one observation quality to a prototype's record (method.md#prototype-quality)."""
    num = value.num_qualities + 1
    rate = jnp.clip(1.0 / num.astype(quality.dtype), _QUALITY_RATE_MIN, _QUALITY_RATE_MAX)
    return dataclasses.replace(
        value,
        quality_sum=value.quality_sum + quality,
        num_qualities=num,
        quality_recent=(1.0 - rate) * value.quality_recent + rate * quality,
    )


def move_towards(
    embedding: Float[Array, "D"], vector: Float[Array, "D"], rate: Float[Array, ""]
) -> Float[Array, "D"]:
    """Steps from a prototype to an observation and back to unit length; rate 0 changes nothing."""
    step = rate.astype(jnp.float32)
    moved = to_unit((1.0 - step) * embedding + step * vector)
    return jnp.where(rate > 0, moved, embedding)


def similarity_rate(
    similarity: Float[Array, ""],
    duplicate: Float[Array, ""],
    margin: Float[Array, ""],
    low: Float[Array, ""],
    high: Float[Array, ""],
    scale: Float[Array, ""],
) -> Float[Array, ""]:
    """Step of a similarity-gated update: none in the margin, then from `low` to `high`.

    Rule: method.md#similarity-step.
    """
    low, high = jnp.clip(low, 0.0, 1.0), jnp.clip(high, 0.0, 1.0)
    low, high = jnp.minimum(low, high), jnp.maximum(low, high)
    gate = duplicate + margin
    ramp = jnp.clip((similarity - gate) / jnp.maximum(1e-6, 1.0 - gate), 0.0, 1.0)
    rate = (low + (high - low) * ramp) * jnp.clip(scale, 0.0, 1.0)
    return jnp.where(similarity < gate, 0.0, rate)


def closest_pair(
    bank: Bank,
) -> tuple[Float[Array, ""], Int[Array, ""], Int[Array, ""], Float[Array, "S S"]]:
    """Cosine and indices `i < j` of the closest pair, the first among equals; and all cosines.

    The cosine is -1 for fewer than two prototypes (method.md#bank-room).
    """
    cosine = dot(bank.embedding, bank.embedding).astype(bank.quality_sum.dtype)
    slots = bank.hits.shape[-1]
    both = live(bank)[:, None] & live(bank)[None]
    upper = jnp.triu(jnp.ones((slots, slots), bool), 1) & both
    flat = jnp.where(upper, cosine, -1.0).ravel()
    index = jnp.argmax(flat)
    return flat[index], index // slots, index % slots, jnp.where(both, cosine, -1.0)


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


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Arrival:
    """A prototype that enters one of the two banks, or none; leading axes as those of the banks."""

    value: Bank
    to_work: Bool[Array, "..."]
    to_stable: Bool[Array, "..."]


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Room:
    """How a full bank makes room; work and stable bank side by side."""

    capacity: Int[Array, "C 2"]  # prototypes per channel
    merge: Float[Array, "2"]  # the closest pair is joined from this cosine on
    redundant: Bool[Array, "2"]  # give up redundant prototypes, else the least recently seen
    cap: Int[Array, ""] | None  # weight of a joined prototype; None: equal weights


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
