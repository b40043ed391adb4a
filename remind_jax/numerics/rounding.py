"""Sums, products and quotients whose rounding does not depend on the compiler.

Sets that are equally good by the rules differ in the last bit, by the order in which their terms
were added, and that bit decides which of them comes first. Adding in the original's order and
rounding where it rounds keeps such decisions (method.md#rounding).
"""

from __future__ import annotations

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

_SHORT = 1e-12  # length of a vector without a direction
_UNROLL = 8  # additions per turn of the loop


def sum_in_order(values: Float[Array, "X *V"], counted: Bool[Array, "X *C"]) -> Float[Array, "*B"]:
    """Adds the counted values along the first axis, one after the other; the rest broadcasts."""

    def add(so_far: Array, term: tuple[Array, Array]) -> tuple[Array, None]:
        value, counts = term
        return so_far + jnp.where(counts, value, 0.0), None

    shape = jnp.broadcast_shapes(values.shape[1:], counted.shape[1:])
    start = jnp.zeros(shape, values.dtype)
    return jax.lax.scan(add, start, (values, counted), unroll=_UNROLL)[0]


def multiply(left: Float[Array, "..."], right: Float[Array, "..."]) -> Float[Array, "..."]:
    """The rounded product, 0 if it is not a number.

    Without the choice between, the compiler would round the product and a sum of it only once.
    """
    product = left * right
    return jnp.where(jnp.isnan(product), 0.0, product)


def unit(vectors: Float[Array, "*B D"]) -> Float[Array, "*B D"]:
    """Vectors scaled to unit length, each number divided; one shorter than 1e-12 becomes zero."""
    norm = jnp.sqrt(jnp.sum(vectors * vectors, axis=-1, keepdims=True))
    return jnp.where(norm < _SHORT, 0.0, divide(vectors, jnp.maximum(norm, _SHORT)))


def divide(numerator: Float[Array, "*#B"], denominator: Float[Array, "*#B"]) -> Float[Array, "*B"]:
    """The rounded quotient; the two are broadcast.

    Of a denominator that is constant or has fewer elements, the compiler would take the reciprocal
    and multiply, which rounds twice.
    """
    whole = jnp.broadcast_to(denominator, jnp.broadcast_shapes(numerator.shape, denominator.shape))
    return numerator / jax.lax.optimization_barrier(whole)
