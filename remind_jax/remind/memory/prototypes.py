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
from remind_jax.numerics.columns import columns
from remind_jax.numerics.constant_arrays import full, zeros
from remind_jax.numerics.control_flow import branch
from remind_jax.numerics.pooling import dot, to_unit
from remind_jax.numerics.pytree import choose, pytree
from remind_jax.numerics.ranks import first_largest, largest
from remind_jax.numerics.reductions import reduce_together
from remind_jax.numerics.rounding import divide
from remind_jax.numerics.slices import spread_over_batch
from remind_jax.remind.memory.writing import write_rows

WORK, STABLE = 0, 1  # fresh prototypes, and those that proved themselves
_QUALITY_RATE_MIN, _QUALITY_RATE_MAX = 0.08, 0.30


@pytree
class Bank:
    """Prototypes of one kind, oldest first; leading axes are banks, channels and objects."""

    embedding: Float[Array, "... S D"]  # unit vectors, float32
    counts: Int[Array, "... S 3"]  # hits, last_seen, num_qualities
    qualities: Float[Array, "... S 2"]  # quality_recent, quality_sum
    size: Int[Array, "..."]  # live slots

    @property
    def hits(self) -> Int[Array, "..."]:
        """Observations that agreed."""
        return self.counts[..., 0]

    @property
    def last_seen(self) -> Int[Array, "..."]:
        """Frame of the last of them."""
        return self.counts[..., 1]

    @property
    def num_qualities(self) -> Int[Array, "..."]:
        """Number of qualities in the sum."""
        return self.counts[..., 2]

    @property
    def quality_recent(self) -> Float[Array, "..."]:
        """Exponential mean of the observation quality, [0, 1]."""
        return self.qualities[..., 0]

    @property
    def quality_sum(self) -> Float[Array, "..."]:
        """Sum of the observation qualities."""
        return self.qualities[..., 1]

    @property
    def work(self) -> Bank:
        """The work banks, where the first axis is that of the two banks."""
        return jax.tree.map(lambda leaf: leaf[WORK], self)

    @property
    def stable(self) -> Bank:
        """The stable banks, likewise."""
        return jax.tree.map(lambda leaf: leaf[STABLE], self)


def count(
    hits: Int[Array, "..."], last_seen: Int[Array, "..."], num_qualities: Int[Array, "..."] | int
) -> Int[Array, "... 3"]:
    """The `counts` of a bank."""
    return columns(hits, last_seen, num_qualities)


def empty_bank(leading: tuple[int, ...], slots: int, dim: int, scalar: jnp.dtype) -> Bank:
    """A bank without prototypes for each entry of the leading axes."""
    shape = (*leading, slots)
    return Bank(
        embedding=zeros((*shape, dim), np.float32),
        counts=full((*shape, 3), 0, np.int32) + np.array([0, NEVER, 0], np.int32),
        qualities=zeros((*shape, 2), scalar),
        size=zeros(leading, np.int32),
    )


def keep_rows(bank: Bank, kept: Bool[Array, "R"]) -> Bank:
    """Empties the banks of the other rows, which are the last leading axis."""
    return dataclasses.replace(bank, size=jnp.where(kept, bank.size, 0))


def live(bank: Bank) -> Bool[Array, "... S"]:
    """Slots that hold a prototype."""
    return jnp.arange(bank.embedding.shape[-2]) < bank.size[..., None]


def mean_quality(bank: Bank) -> Float[Array, "..."]:
    """Mean observation quality of each prototype, [0, 1] (method.md#prototype-quality)."""
    return jnp.clip(bank.quality_sum / jnp.maximum(1, bank.num_qualities), 0.0, 1.0)


def confidence(bank: Bank, promote_hits: Int[Array, ""]) -> Float[Array, "..."]:
    """How far each prototype has proved itself, [0, 1] (method.md#prototype-quality)."""
    needed = jnp.where(promote_hits > 0, promote_hits, 4)
    scalar = bank.quality_sum.dtype
    share = jnp.minimum(1.0, divide(bank.hits.astype(scalar), needed.astype(scalar)))
    return jnp.clip(share * jnp.maximum(mean_quality(bank), bank.quality_recent), 0.0, 1.0)


def nearest(bank: Bank, vector: Float[Array, "D"]) -> tuple[Int[Array, ""], Float[Array, ""]]:
    """The most similar prototype and its cosine, -inf for an empty bank (method.md#banks)."""
    cosine, index = largest(similarities(bank, vector))
    return index, cosine


def similarities(bank: Bank, vectors: Float[Array, "*#B D"]) -> Float[Array, "*B S"]:
    """Cosine of a unit vector with every prototype of its bank, -inf in free slots.

    The banks stay where they are: of a batch, one that is mapped over another axis than the first
    would be copied. So many banks are compared by one call, not by a map over them.
    """
    leading = bank.embedding.shape[:-2]
    vectors = jnp.broadcast_to(vectors, (*leading, vectors.shape[-1]))
    cosine = dot(*spread_over_batch(vectors[..., None, :], bank.embedding))[..., 0, :]
    return jnp.where(live(bank), cosine.astype(bank.qualities.dtype), -jnp.inf)


def entry(bank: Bank, index: Int[Array, ""]) -> Bank:
    """One prototype as a bank without the slot axis."""
    (one,) = entries(bank, index)
    return one


def entries(bank: Bank, *index: Int[Array, ""]) -> list[Bank]:
    """Several prototypes, each as a bank without the slot axis."""
    is_here = (columns(*index) == jnp.arange(bank.counts.shape[0])[:, None])[..., None]
    # Of a batch, a look-up would write its indices down first; short rows are chosen by a mask.
    wide = jnp.pad(bank.qualities, ((0, 0), (0, bank.counts.shape[1] - bank.qualities.shape[1])))
    counts, qualities = reduce_together(
        ("sum", jnp.where(is_here, bank.counts[:, None], 0)),
        ("sum", jnp.where(is_here, wide[:, None], 0)),
        axis=0,
    )
    return [
        Bank(
            embedding=bank.embedding[at],
            counts=counts[number],
            qualities=qualities[number, : bank.qualities.shape[1]],
            size=bank.size,
        )
        for number, at in enumerate(index)
    ]


def new_entry(vector: Float[Array, "D"], quality: Float[Array, ""], now: Int[Array, ""]) -> Bank:
    """The prototype that one observation founds."""
    one = jnp.int32(1)
    return Bank(vector, count(one, now.astype(jnp.int32), one), columns(quality, quality), one)


@pytree
class Edit:
    """What happens to the prototypes of a bank: one is replaced, then one taken out."""

    at: Int[Array, "..."]
    value: Bank  # takes the place of the prototype there
    replaces: Bool[Array, "..."]
    gone: Int[Array, "..."]  # taken out, and the gap is closed
    removes: Bool[Array, "..."]


def change(bank: Bank, edit: Edit, arrival: Bank, adds: Bool[Array, ""]) -> Bank:
    """The bank after an edit, with a prototype added at the end; the caller made room for it."""
    slots = bank.embedding.shape[0]
    place = jnp.arange(slots)
    shifts = edit.removes & (place >= edit.gone)
    is_replaced = (place + shifts == edit.at) & edit.replaces
    end = bank.size - edit.removes.astype(jnp.int32)
    is_added = (place == end) & adds

    def edit_slots(old: Array, value: Array, added: Array) -> Array:
        """All slots at once, which fuses with its neighbors, where a scatter would not."""
        moved = choose(shifts, jnp.concatenate([old[1:], jnp.zeros_like(old[:1])]), old)
        return choose(is_added, added, choose(is_replaced, value, moved))

    size = end + adds.astype(jnp.int32)
    slots = [dataclasses.replace(one, size=None) for one in (bank, edit.value, arrival)]
    return dataclasses.replace(jax.tree.map(edit_slots, *slots), size=size)


def change_all(banks: Bank, edit: Edit, arrival: Bank, adds: Bool[Array, "2 C N"]) -> Bank:
    """`change` of all banks `[2 C N]`; of what arrives `[C N]` each bank takes what it adds.

    Where none gives up a prototype, which closes a gap, one row of each is written, if any: on a
    CPU that takes less than to make all of them anew.
    """

    def change_banks() -> Bank:
        # In the order of the axes, so that no bank is turned around.
        of_channels = jax.vmap(jax.vmap(change))
        return jax.vmap(of_channels, (0, 0, None, 0))(banks, edit, arrival, adds)

    def write_prototypes() -> Bank:
        num_slots = banks.embedding.shape[-2]
        first = num_slots * jnp.arange(adds.size, dtype=jnp.int32).reshape(adds.shape)
        row = first + jnp.where(adds, banks.size, edit.at)
        row = jnp.where(adds | edit.replaces, row, -1)
        slots = dataclasses.replace(banks, size=None)
        values = dataclasses.replace(choose(adds, arrival, edit.value), size=None)
        memory, values = jax.tree.map(
            lambda leaf: leaf.reshape(-1, leaf.shape[-1]), (slots, values)
        )
        written = write_rows(memory, row.ravel(), values)
        written = jax.tree.map(lambda new, old: new.reshape(old.shape), written, slots)
        return dataclasses.replace(written, size=banks.size + adds.astype(jnp.int32))

    if jax.default_backend() != "cpu":
        return change_banks()
    return branch(jnp.any(edit.removes), change_banks, write_prototypes, suits_all=True)


def count_quality(value: Bank, quality: Float[Array, ""]) -> Bank:
    """Adds one observation quality to a prototype's record (method.md#prototype-quality)."""
    num = value.num_qualities + 1
    rate = jnp.clip(1.0 / num.astype(quality.dtype), _QUALITY_RATE_MIN, _QUALITY_RATE_MAX)
    recent = (1.0 - rate) * value.quality_recent + rate * quality
    return dataclasses.replace(
        value,
        counts=count(value.hits, value.last_seen, num),
        qualities=columns(recent, value.quality_sum + quality),
    )


def move_toward(
    embedding: Float[Array, "D"], vector: Float[Array, "D"], rate: Float[Array, ""]
) -> Float[Array, "D"]:
    """Steps from a prototype to an observation and back to unit length; rate 0 changes nothing."""
    step = rate.astype(jnp.float32)
    moved = to_unit((1.0 - step) * embedding + step * vector)
    return jnp.where(rate > 0, moved, embedding)


def closest_pair(
    bank: Bank,
) -> tuple[Float[Array, ""], Int[Array, ""], Int[Array, ""], Float[Array, "S S"]]:
    """Cosine and indices `i < j` of the closest pair, the first among equals; and all cosines.

    The cosine is -1 for fewer than two prototypes (method.md#bank-room).
    """
    cosine = dot(bank.embedding, bank.embedding).astype(bank.qualities.dtype)
    slots = bank.embedding.shape[-2]
    both = live(bank)[:, None] & live(bank)[None]
    place = np.arange(slots)
    most, i, j = first_largest([jnp.where((place[:, None] < place) & both, cosine, -1.0)])
    return most, i, j, jnp.where(both, cosine, -1.0)
