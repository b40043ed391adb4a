"""Attention beside softmax written out in float64."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.special import softmax

from remind_jax.backbone.vit_attention import NO_PATCH, attend, attention_among

EXACT = jax.lax.Precision.HIGHEST


def draw(num: int, *shape: int) -> list[jax.Array]:
    rng = np.random.default_rng(0)
    return [jnp.asarray(rng.normal(size=shape), jnp.float32) for _ in range(num)]


def whole_map(q: jax.Array, k: jax.Array) -> np.ndarray:
    """Attention of every token, `[B, H, N, N]`."""
    return softmax(np.einsum("bhne,bhme->bhnm", *(np.asarray(x, float) for x in (q, k))), axis=-1)


@pytest.mark.parametrize("method", ["plain", "chunked"])
def test_attention_is_softmax_of_scores(method):
    q, k, v = draw(3, 2, 3, 37, 8)
    mixed = attend(q, k, v, method, EXACT)
    # float32 sums of 37 products of numbers around one.
    np.testing.assert_allclose(mixed, whole_map(q, k) @ np.asarray(v), rtol=0, atol=1e-5)


@pytest.mark.parametrize("size", [1e-3, 1.0, 7.0, 300.0])
def test_chunked_attention_of_scores_of_any_size(size):
    """Small ones are not shifted, large ones are; neither overflows."""
    rng = np.random.default_rng(0)
    q, k, v = (jnp.asarray(rng.normal(size=(2, 3, 150, 8)), jnp.float32) for _ in range(3))
    q = q.at[0].multiply(size)
    plain, chunked = (attend(q, k, v, method, EXACT) for method in ("plain", "chunked"))
    assert np.isfinite(plain).all()
    # The rounding of a score, 6e-8 of it, is carried into its exponential; they reach 40 and 2000.
    np.testing.assert_allclose(plain, chunked, rtol=0, atol=1e-5 if size < 10 else 1e-3)


@pytest.mark.parametrize("heads", [None, (2,), (0, 2)])
def test_attention_among_patches_is_a_block_of_the_mean_over_heads(heads):
    num_prefix, patches = 2, np.array([[4, NO_PATCH, 0]])
    q, k = draw(2, 1, 3, 12, 8)
    found = attention_among(q, k, jnp.asarray(patches), num_prefix, heads, EXACT)
    mean = whole_map(q, k)[0, list(heads or range(3))].mean(axis=0)
    rows = mean[np.ix_([6, 2], range(num_prefix, 12))]
    np.testing.assert_allclose(found.row_sums[0, [0, 2]], rows.sum(axis=1), rtol=0, atol=1e-6)
    np.testing.assert_allclose(
        found.block[0][np.ix_([0, 2], [0, 2])], rows[:, [4, 0]], rtol=0, atol=1e-6
    )
    assert not found.row_sums[0, 1]
    assert not found.block[0, 1].any()
    assert not found.block[0, :, 1].any()
