"""Banks of a few prototypes, given by their directions."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer

from remind_jax.remind.memory.prototypes import Bank, Edit, change, empty_bank, entry, new_entry

NOW = jnp.int32(9)


def unit(degrees):
    return np.array([np.cos(np.radians(degrees)), np.sin(np.radians(degrees))], np.float32)


@jax.jit
def append(bank, value, when=True):
    return change(bank, edit_of(bank), value, jnp.bool_(when))


def edit_of(bank, at=None, value=None, gone=None):
    """Replaces one prototype, takes one out, or does nothing."""
    place = lambda index: jnp.int32(index or 0)  # noqa: E731
    is_given = lambda index: jnp.bool_(index is not None)  # noqa: E731
    value = entry(bank, jnp.int32(0)) if value is None else value
    return Edit(place(at), value, is_given(at), place(gone), is_given(gone))


def edited(bank, **edit):
    return change(bank, edit_of(bank, **edit), entry(bank, jnp.int32(0)), jnp.bool_(False))


def with_records(bank: Bank, **columns) -> Bank:
    """A bank with other columns of its records, given by their names."""
    leaves = {"counts": bank.counts, "qualities": bank.qualities}
    places = {
        "hits": ("counts", 0), "last_seen": ("counts", 1), "num_qualities": ("counts", 2),
        "quality_recent": ("qualities", 0), "quality_sum": ("qualities", 1),
    }  # fmt: skip
    for name, column in columns.items():
        leaf, place = places[name]
        if isinstance(column, jax.Array) or isinstance(leaves[leaf], Tracer):
            leaves[leaf] = jnp.asarray(leaves[leaf]).at[..., place].set(column)
            continue
        leaves[leaf] = np.array(leaves[leaf])
        leaves[leaf][..., place] = column
    return dataclasses.replace(bank, **leaves)


def bank_of(*vectors, last_seen=None, slots=4):
    """A bank with prototypes of one hit and quality 0.5."""
    vectors = [np.asarray(v, np.float32) for v in vectors]
    dim = vectors[0].shape[0] if vectors else 2
    bank = empty_bank((), slots, dim, jnp.dtype("float32"))
    for index, vector in enumerate(vectors):
        now = jnp.int32(index if last_seen is None else last_seen[index])
        bank = append(bank, _entry(vector, np.float32(0.5), now))
    return jax.tree.map(jnp.asarray, bank)


_entry = jax.jit(new_entry)


def vectors_of(bank):
    return np.asarray(bank.embedding)[: int(bank.size)]
