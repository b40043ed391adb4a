import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from remind_jax.backbone import cell_histograms as ch

FLOAT32_SUM = 1e-5  # a few hundred float32 additions of values of order one
COORDINATES = st.floats(-8, 8, width=32, allow_subnormal=False)


def draw(*shape: int) -> jax.Array:
    return jnp.asarray(np.random.default_rng(0).normal(size=shape), jnp.float32)


soft_bins = jax.jit(ch.soft_bins, static_argnums=(1, 2, 3))
joint_histogram = jax.jit(ch.joint_histogram)


@settings(deadline=None, max_examples=30)
@given(st.lists(st.floats(-5, 5, width=32), min_size=8, max_size=8), st.sampled_from((2, 5, 10)))
def test_shares_of_a_pixel_sum_to_one_and_keep_its_value(values, num):
    pixels = np.array([values], np.float32)
    shares = np.asarray(soft_bins(pixels, -2.0, 2.0, num))
    np.testing.assert_allclose(shares.sum(0), 1, atol=FLOAT32_SUM)
    mean = np.tensordot(np.linspace(-2, 2, num), shares, 1)
    np.testing.assert_allclose(mean, np.clip(pixels, -2, 2), atol=FLOAT32_SUM)


def test_joint_histogram_counts_pairs_and_has_the_margins():
    first = soft_bins(draw(16, 24), -1.0, 1.0, 3)
    second = soft_bins(draw(16, 24) ** 2, 0.0, 2.0, 4)
    joint = np.asarray(joint_histogram(first, second)).reshape(3, 4, 2, 3)
    np.testing.assert_allclose(joint.sum(1), ch.cell_mean(first), atol=FLOAT32_SUM)
    np.testing.assert_allclose(joint.sum(0), ch.cell_mean(second), atol=FLOAT32_SUM)
    corner = np.einsum("kij,lij->kl", first[:, 8:, 16:], second[:, 8:, 16:]) / 64
    np.testing.assert_allclose(joint[..., 1, 2], corner, atol=FLOAT32_SUM)


@settings(deadline=None, max_examples=100)
@given(COORDINATES, COORDINATES)
def test_angles_are_those_of_arctan2(y, x):
    turns = float(ch.angle(jnp.float32(y), jnp.float32(x)))
    expected = np.arctan2(y, x) / (2 * np.pi) if (y or x) else 0.0
    # Half a turn and minus half a turn are one direction.
    assert abs((turns - expected + 0.5) % 1.0 - 0.5) < 1e-7


@pytest.mark.parametrize("shape", [(4, 6), (5, 7), (2, 1)])
def test_only_tiles_with_a_needed_cell_are_measured(shape):
    tile = (min(2, shape[0]), min(3, shape[1]))
    rows, columns = np.indices(shape)
    needed = (rows == shape[0] - 1) & (columns == 0)
    values = draw(*(ch.CELL_PX * side for side in shape))
    planes = {"plain": values[None], "wide": jnp.pad(values, 1)}

    def measure(planes):
        (left,) = ch.shifts(planes["wide"], 1, [(0, -1)])
        return ch.cell_mean(jnp.stack([planes["plain"][0], left]))

    cells = ch.measure_tiles(measure, planes, jnp.asarray(needed), tile)
    whole = measure(planes)
    inside = (rows // tile[0] == (shape[0] - 1) // tile[0]) & (columns < tile[1])
    np.testing.assert_allclose(cells, np.where(inside, whole, 0), atol=FLOAT32_SUM)
