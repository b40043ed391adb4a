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
soft_bins_periodic = jax.jit(ch.soft_bins_periodic, static_argnums=1)
joint_histogram = jax.jit(ch.joint_histogram)


@settings(deadline=None, max_examples=30)
@given(st.lists(st.floats(-5, 5, width=32), min_size=8, max_size=8), st.sampled_from((2, 5, 10)))
def test_shares_of_a_pixel_sum_to_one_and_keep_its_value(values, num):
    pixels = np.array([values], np.float32)
    shares = np.asarray(soft_bins(pixels, -2.0, 2.0, num))
    np.testing.assert_allclose(shares.sum(0), 1, atol=FLOAT32_SUM)
    mean = np.tensordot(np.linspace(-2, 2, num), shares, 1)
    np.testing.assert_allclose(mean, np.clip(pixels, -2, 2), atol=FLOAT32_SUM)


@settings(deadline=None, max_examples=30)
@given(st.floats(-2, 2, width=32), st.integers(-3, 3), st.sampled_from((3, 16)))
def test_angles_a_whole_turn_apart_share_bins(turns, whole, num):
    shares = np.asarray(soft_bins_periodic(np.full((1, 1), turns, np.float32), num))
    again = soft_bins_periodic(np.full((1, 1), turns + whole, np.float32), num)
    np.testing.assert_allclose(shares.sum(), 1, atol=FLOAT32_SUM)
    # Angles of up to five turns are known to 5e-7 turns in float32, bins are 1/16 turn wide.
    np.testing.assert_allclose(shares, again, atol=2e-5)


def test_joint_histogram_counts_pairs_and_has_the_margins():
    first = soft_bins(draw(16, 24), -1.0, 1.0, 3)
    second = soft_bins(draw(16, 24) ** 2, 0.0, 2.0, 4)
    joint = np.asarray(joint_histogram(first, second)).reshape(3, 4, 2, 3)
    np.testing.assert_allclose(joint.sum(1), ch.cell_mean(first), atol=FLOAT32_SUM)
    np.testing.assert_allclose(joint.sum(0), ch.cell_mean(second), atol=FLOAT32_SUM)
    corner = np.einsum("kij,lij->kl", first[:, 8:, 16:], second[:, 8:, 16:]) / 64
    np.testing.assert_allclose(joint[..., 1, 2], corner, atol=FLOAT32_SUM)


def test_window_mean_leaves_out_what_is_outside():
    cells = jnp.arange(12, dtype=jnp.float32).reshape(3, 4)
    windows = ch.window_mean(cells, 1)
    assert windows[0, 0] == pytest.approx(np.mean([0, 1, 4, 5]))
    assert windows[1, 2] == pytest.approx(cells[:, 1:].mean())
    np.testing.assert_allclose(ch.window_mean(cells, 3), cells.mean(), atol=FLOAT32_SUM)


def test_shifts_look_in_the_direction_named():
    values = jnp.arange(20, dtype=jnp.float32).reshape(4, 5)
    down, right, up_left = ch.shifts(jnp.pad(values, 2, "edge"), 2, ((1, 0), (0, 2), (-1, -1)))
    np.testing.assert_array_equal(down[:3], values[1:])
    np.testing.assert_array_equal(down[3], values[3])
    np.testing.assert_array_equal(right[:, :3], values[:, 2:])
    np.testing.assert_array_equal(up_left[1:, 1:], values[:-1, :-1])


def test_smoothing_keeps_constants_and_reaches_no_further_than_told():
    np.testing.assert_allclose(ch.smooth(jnp.full((2, 9, 7), 3.0), 1.5, 4), 3, atol=FLOAT32_SUM)
    spot = ch.smooth(jnp.zeros((21, 21)).at[10, 10].set(1), 1.5, 4)
    assert spot.sum() == pytest.approx(1, abs=FLOAT32_SUM)
    assert spot[10, 14] > 0
    assert float(jnp.abs(spot[:, 15:]).max()) == 0
    np.testing.assert_allclose(spot, spot.T, atol=FLOAT32_SUM)


def test_spreading_undoes_the_mean_of_cells():
    cells = draw(2, 3, 4)
    np.testing.assert_allclose(ch.cell_mean(ch.spread(cells)), cells, atol=FLOAT32_SUM)
    np.testing.assert_allclose(
        ch.above_surround(ch.spread(cells), 0), np.zeros((2, 24, 32)), atol=FLOAT32_SUM
    )


def test_halving_averages_squares():
    image = np.random.default_rng(0).integers(0, 256, (4, 6, 3), np.uint8)
    squares = image.reshape(2, 2, 3, 2, 3).astype(np.float32).mean((1, 3))
    np.testing.assert_array_equal(ch.halve(jnp.asarray(image)), np.moveaxis(squares, -1, 0))


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
