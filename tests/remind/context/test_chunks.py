import jax
import jax.numpy as jnp
import numpy as np
import pytest

from remind_jax.remind.context.chunks import by_chunks


def describe(rows):
    """A function of rows with two results of different types and shapes."""
    value, weight = rows
    return {"sum": jnp.sum(value * weight[:, None], axis=1), "order": jnp.argsort(value, axis=1)}


@jax.jit
def _apply(value, weight, used):
    return by_chunks(describe, (value, weight), used)


def apply(value, weight, used):
    return jax.device_get(_apply(value, weight, np.int32(used)))


@pytest.mark.parametrize("width", [1, 7, 16, 17, 40])
def test_used_rows_are_as_if_all_were_worked_on(width):
    generator = np.random.default_rng(width)
    value = generator.integers(-9, 9, (width, 3)).astype(np.float32)
    weight = generator.integers(1, 9, width).astype(np.float32)
    whole = jax.device_get(jax.jit(describe)((value, weight)))
    for used in range(width + 1):
        found = apply(value, weight, used)
        for name in whole:
            assert found[name].dtype == whole[name].dtype
            np.testing.assert_array_equal(found[name][:used], whole[name][:used])


def test_batches_of_different_fill():
    value = np.arange(2 * 20 * 3, dtype=np.float32).reshape(2, 20, 3)
    weight = np.ones((2, 20), np.float32)
    used = np.array([3, 20])
    together = jax.device_get(jax.vmap(_apply)(value, weight, used))
    for row in range(2):
        alone = apply(value[row], weight[row], used[row])
        count = used[row]
        np.testing.assert_array_equal(together["sum"][row][:count], alone["sum"][:count])
