import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from remind_jax.numerics.pooling import dot, keep_typical, pool, to_unit


def test_empty_region_is_absent_and_zero():
    mean, present = pool(np.zeros((2, 9), np.float32), np.ones((9, 2), np.float32))
    assert not present.any()
    assert not mean.any()


@pytest.mark.parametrize("length", [0.0, 1e-13])
def test_vector_without_direction_becomes_zero(length):
    vector = jnp.array([length, 0.0, 0.0], jnp.float32)
    assert not to_unit(vector).any()


def test_dot_ignores_the_default_precision_of_the_device():
    left, right = (np.random.default_rng(s).standard_normal((5, 64)) for s in (0, 1))
    with jax.default_matmul_precision("bfloat16"):
        result = dot(jnp.float32(left), jnp.float32(right))
    # bfloat16 products would be off by 1e-2
    np.testing.assert_allclose(result, left @ right.T, atol=1e-5)


KEEP = jax.jit(keep_typical)


def test_equally_typical_patches_are_kept_in_raster_order():
    features, members = np.ones((10, 3), np.float32), np.arange(10)[None] > 0
    kept = KEEP(features, features[:1], members, jnp.float32(0.5), jnp.int32(8))
    assert np.flatnonzero(kept[0]).tolist() == [1, 2, 3, 4, 5]


@given(st.integers(0, 2**32 - 1), st.integers(1, 16).map(lambda n: n / 16), st.integers(0, 20))
def test_kept_are_the_most_similar_members(seed, share, min_patches):
    rng = np.random.default_rng(seed)
    features = rng.integers(-3, 4, (20, 3)).astype(np.float32)
    members = rng.random((2, 20)) < 0.7
    mean = rng.integers(-3, 4, (2, 3)).astype(np.float32)
    kept = np.asarray(KEEP(features, mean, members, jnp.float32(share), jnp.int32(min_patches)))
    assert not (kept & ~members).any()
    norm = np.linalg.norm(features, axis=1) * np.linalg.norm(mean, axis=1)[:, None]
    similarity = mean @ features.T / (norm + 1e-12)
    for row in range(2):
        count = members[row].sum()
        wanted = count if count < min_patches else max(1, np.ceil(share * count))
        assert kept[row].sum() == min(wanted, count)
        taken, left = (similarity[row][members[row] & part] for part in (kept[row], ~kept[row]))
        if len(taken) and len(left):
            assert taken.min() >= left.max() - 1e-6  # float32 rounding of equal directions
