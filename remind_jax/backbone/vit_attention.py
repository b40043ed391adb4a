"""Attention of a vision transformer in little memory, and what attention parts need of it.

Letters: `B` images, `H` heads, `N` tokens, `E` features per head, `K` patches of objects. Queries
come already multiplied by `E ** -0.5`.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from typing import Literal

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from remind_jax.numerics.pytree import pytree

# plain     all scores of a layer at once
# chunked   head by head, some rows of queries at a time: scores stay in the cache of a CPU
Method = Literal["plain", "chunked"]

# As measured on CPUs with 256-bit vectors: fewer scores starve the matrix product, more of them
# leave the cache. Rows of queries come in multiples of what vectors and threads share evenly.
_SCORES_AT_ONCE = 240_000
_QUERIES_MULTIPLE = 32
_OBJECT_ROWS_AT_ONCE = 256
# Sums of millions of exponentials of scores up to this (by size) stay well inside float32.
_SAFE_SCORE = 60.0
NO_PATCH = -1


@pytree
class ObjectAttention:
    """Mean attention over layers and heads, of patches of objects only; unused slots are zero.

    Rows are not rescaled: what a patch pays to cls and registers is missing in its sum.
    """

    row_sums: Float[Array, "B K"]  # of each object patch, over all patches of the image
    block: Float[Array, "B K K"]  # from object patch to object patch

    @classmethod
    def zeros(cls, num_images: int, num_patches: int) -> ObjectAttention:
        """Nothing seen yet."""
        shape = (num_images, num_patches)
        return cls(jnp.zeros(shape), jnp.zeros((*shape, num_patches)))


def attend(
    queries: Float[Array, "B H N E"],
    keys: Float[Array, "B H N E"],
    values: Float[Array, "B H N E"],
    method: Method,
    precision: jax.lax.Precision,
) -> Float[Array, "B H N E"]:
    """Softmax attention over all tokens; scores and softmax in the type of the queries."""
    if method == "plain":
        return _weigh(queries, keys, values, precision)

    at_once = max(1, _SCORES_AT_ONCE // keys.shape[2] // _QUERIES_MULTIPLE) * _QUERIES_MULTIPLE

    def attend_head(head: tuple[Array, Array, Array]) -> Array:
        q, k, v = head
        weigh = functools.partial(_weigh_upright, keys=k, values_t=v.T, precision=precision)
        largest = jnp.sqrt(jnp.max(jnp.sum(q * q, axis=-1)) * jnp.max(jnp.sum(k * k, axis=-1)))
        return jax.lax.cond(
            largest < _SAFE_SCORE,
            lambda rows: _map_rows(functools.partial(weigh, shifted=False), rows, at_once),
            lambda rows: _map_rows(functools.partial(weigh, shifted=True), rows, at_once),
            q,
        )

    merged = [t.reshape(-1, *t.shape[2:]) for t in (queries, keys, values)]
    return jax.lax.map(attend_head, tuple(merged)).reshape(values.shape)


def _weigh(queries: Array, keys: Array, values: Array, precision: jax.lax.Precision) -> Array:
    """Attention of some queries; divides by the sum last, where fewer numbers are left."""
    weights = _exponentials(queries, keys, precision)
    total = jnp.sum(weights, axis=-1, keepdims=True)
    mixed = jnp.einsum(
        "...nm,...me->...ne",
        weights.astype(values.dtype),
        values,
        precision=_precision_with(values, precision),
        preferred_element_type=jnp.float32,
    )
    return (mixed / total).astype(values.dtype)


def _weigh_upright(
    queries: Float[Array, "C E"],
    keys: Float[Array, "N E"],
    values_t: Float[Array, "E N"],
    precision: jax.lax.Precision,
    shifted: bool,
) -> Float[Array, "C E"]:
    """`_weigh` with scores `[N, C]`: a CPU's vectors then run across queries in every reduction.

    Softmax does not change if all scores of a query are shifted; `shifted` makes the largest zero,
    which costs two passes and is needed only where exponentials could overflow.
    """
    product = functools.partial(jnp.matmul, preferred_element_type=jnp.float32)
    scores = product(keys, queries.T, precision=precision)
    weights = jnp.exp(scores - jnp.max(scores, axis=0) if shifted else scores)
    weights_cast = weights.astype(values_t.dtype)
    mixed = product(values_t, weights_cast, precision=_precision_with(values_t, precision))
    mixed = mixed / jnp.sum(weights, axis=0)
    return mixed.T.astype(values_t.dtype)


def _precision_with(values: Array, precision: jax.lax.Precision) -> jax.lax.Precision | None:
    """Numbers that are rounded already are multiplied at full speed."""
    return precision if values.dtype == jnp.float32 else None


def _exponentials(queries: Array, keys: Array, precision: jax.lax.Precision) -> Array:
    """Unscaled softmax weights; the largest of each row is one."""
    scores = jnp.einsum("...ne,...me->...nm", queries, keys, precision=precision)
    return jnp.exp(scores - jnp.max(scores, axis=-1, keepdims=True))


def _map_rows(function: Callable[[Array], Array], rows: Array, at_once: int) -> Array:
    """Applies a function of rows to equal chunks of them, one after another."""
    num = len(rows)
    count = math.ceil(num / at_once)
    size = math.ceil(num / count)
    padded = jnp.pad(rows, [(0, count * size - num)] + [(0, 0)] * (rows.ndim - 1))
    results = jax.lax.map(function, padded.reshape(count, size, *rows.shape[1:]))
    return results.reshape(count * size, *results.shape[2:])[:num]


def attention_among(
    queries: Float[Array, "B H N E"],
    keys: Float[Array, "B H N E"],
    patches: Int[Array, "B K"],
    num_prefix: int,
    heads: tuple[int, ...] | None,
    precision: jax.lax.Precision,
) -> ObjectAttention:
    """Attention of one layer from some patches, averaged over heads.

    Only rows of these patches are computed, and never those of all heads at once.
    """
    if heads is not None:
        queries, keys = queries[:, jnp.array(heads)], keys[:, jnp.array(heads)]
    num_heads = queries.shape[1]

    def one_image(image: tuple[Array, Array, Array]) -> tuple[Array, Array]:
        q, k, places = image
        tokens = num_prefix + jnp.maximum(places, 0)

        def some_rows(chunk: Int[Array, "C"]) -> Float[Array, "C L"]:
            def add_head(sums: Array, head: tuple[Array, Array]) -> tuple[Array, None]:
                weights = _exponentials(head[0][chunk], head[1], precision)
                weights = weights / jnp.sum(weights, axis=-1, keepdims=True)
                total = jnp.sum(weights[:, num_prefix:], axis=-1, keepdims=True)
                return sums + jnp.concatenate([total, weights[:, tokens]], axis=-1), None

            start = jnp.zeros((len(chunk), 1 + len(tokens)), q.dtype)
            return jax.lax.scan(add_head, start, (q, k))[0] / num_heads

        sums = _map_rows(some_rows, tokens, _OBJECT_ROWS_AT_ONCE)
        exists = (places != NO_PATCH).astype(q.dtype)
        return sums[:, 0] * exists, sums[:, 1:] * exists[:, None] * exists

    return ObjectAttention(*jax.lax.map(one_image, (queries, keys, patches)))
