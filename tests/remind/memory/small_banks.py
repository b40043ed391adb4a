"""Banks of a few prototypes, given by their directions."""

import jax.numpy as jnp
import numpy as np

from remind_jax.remind.memory.prototypes import append, empty_bank, new_entry

NOW = jnp.int32(9)
YES, NO = jnp.bool_(True), jnp.bool_(False)


def unit(degrees):
    return jnp.array([np.cos(np.radians(degrees)), np.sin(np.radians(degrees))], jnp.float32)


def bank_of(*vectors, last_seen=None, slots=4):
    """A bank with prototypes of one hit and quality 0.5."""
    vectors = [jnp.asarray(v, jnp.float32) for v in vectors]
    dim = vectors[0].shape[0] if vectors else 2
    bank = empty_bank((), slots, dim, jnp.dtype("float32"))
    for index, vector in enumerate(vectors):
        now = jnp.int32(index if last_seen is None else last_seen[index])
        bank = append(bank, new_entry(vector, jnp.float32(0.5), now), YES)
    return bank


def vectors_of(bank):
    return np.asarray(bank.embedding[: int(bank.size)])
