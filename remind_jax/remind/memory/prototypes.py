"""Prototype banks as ordered lists in fixed slots, work and stable (paper III-C).

The first `size` slots of a bank are live, removal shifts the later ones down, so that every rule
"first among equals" means the older entry. What a bank learns is in `bank`. Functions take one
bank; map them over objects with `jax.vmap`. Letters: `S` slots, `D` dimensions.
"""

from __future__ import annotations

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from remind_jax.numerics.absent import NEVER
from remind_jax.numerics.constant_arrays import full, zeros
from remind_jax.numerics.pooling import dot, to_unit

_QUALITY_RATE_MIN, _QUALITY_RATE_MAX = 0.08, 0.30


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


def keep_rows(banks: DualBank, kept: Bool[Array, "R"]) -> DualBank:
    """Empties the banks of the other rows; leading axes `[C R]`."""
    empty = lambda bank: dataclasses.replace(bank, size=jnp.where(kept, bank.size, 0))  # noqa: E731
    return DualBank(empty(banks.work), empty(banks.stable))


def live(bank: Bank) -> Bool[Array, "... S"]:
    """Slots that hold a prototype."""
    return jnp.arange(bank.hits.shape[-1]) < bank.size[..., None]


def mean_quality(bank: Bank) -> Float[Array, "..."]:
    """Mean observation quality of each prototype, [0, 1] (method.md#prototype-quality)."""
    return jnp.clip(bank.quality_sum / jnp.maximum(1, bank.num_qualities), 0.0, 1.0)


def confidence(bank: Bank, promote_hits: Int[Array, ""]) -> Float[Array, "..."]:
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

    A select over all slots fuses with its neighbors, where a scatter would not.
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


def move_toward(
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
