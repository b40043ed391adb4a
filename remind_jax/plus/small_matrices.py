"""Inverses of small positive matrices, quick inside a compiled program on any device.

LAPACK's triangular solvers start threads for matrices of this size and take milliseconds on a CPU.
"""

from __future__ import annotations

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float

_JITTER = 1e-5  # added to the diagonal of cosines


def diagonal(matrix: Float[Array, "n n"]) -> Float[Array, "n"]:
    """Its diagonal, read in steps: `jnp.diag` would look up each element by its index."""
    return matrix.reshape(-1)[:: len(matrix) + 1]


def invert(matrix: Float[Array, "n n"]) -> Float[Array, "n n"]:
    """Inverse of a symmetric positive definite matrix by Gauss-Jordan elimination.

    Such a matrix needs no pivoting: its pivots stay positive.
    """
    size = matrix.shape[0]
    index = jnp.arange(size)

    def eliminate(k: Array, m: Array) -> Array:
        at_k = index == k
        row, column = m[k], jnp.where(at_k, 0.0, m[:, k])
        row = jnp.where(at_k, 1.0, row) / m[k, k]
        m = jnp.where(at_k[None, :], 0.0, m) - column[:, None] * row[None, :]
        return jnp.where(at_k[:, None], row[None, :], m)

    inverse = lax.fori_loop(0, size, eliminate, matrix)
    return (inverse + inverse.T) / 2


def root_of_inverse(matrix: Float[Array, "n n"]) -> Float[Array, "n n"]:
    """Lower triangle whose product with its transpose is the inverse; NaN where there is none."""
    return jnp.linalg.cholesky(invert(matrix), symmetrize_input=False)


def orthonormalize(columns: Float[Array, "m n"]) -> Float[Array, "m n"]:
    """Columns of unit length at right angles to each other that span the same.

    Columns that depend on each other are kept apart by `_JITTER` and come out shorter.
    """
    length = jnp.sqrt(jnp.sum(columns**2, axis=0))
    unit = columns / jnp.maximum(length, 1e-20)
    gram = jnp.matmul(unit.T, unit, precision="highest")
    gram += _JITTER * jnp.eye(len(gram), dtype=gram.dtype)
    return jnp.matmul(unit, root_of_inverse(gram), precision="highest")
