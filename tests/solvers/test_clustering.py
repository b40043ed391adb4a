"""The twin must label as the host does; ties of exact sums included."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from remind_jax.errors import ConfigError
from remind_jax.numerics.absent import NO_SLOT
from remind_jax.solvers.clustering import kmeans
from remind_jax.solvers.clustering_in_graph import _draw_numbers

# Centers are float32 means of unit vectors, added in another order.
CENTER_ROUNDING = 1e-5
NUM_POINTS, DIM = 160, 16
PARTS = {"clusters": 4, "iterations": 5, "restarts": 2, "seed": 0}
RINGS = {"clusters": 24, "iterations": 10, "restarts": 1, "seed": 1}


_solve = jax.jit(kmeans, static_argnames=("solver", *PARTS))


def solve(solver, options, points, members, wanted=None):
    return _solve(points, members, wanted, solver=solver, **options)


def make_generic(rng, num_sets):
    """Unit vectors without ties, scattered or in clumps; sets from nothing to nearly everything."""
    points = rng.normal(size=(NUM_POINTS, DIM))
    if rng.random() < 0.5:
        points = rng.normal(size=(5, DIM))[rng.integers(0, 5, NUM_POINTS)] + 0.2 * points
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    share = rng.choice([0.0, 0.03, 0.1, 0.9], (num_sets, 1))
    return points.astype(np.float32), rng.random((num_sets, NUM_POINTS)) < share


@pytest.mark.parametrize("options", [PARTS, RINGS])
@settings(
    max_examples=40,
    deadline=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)
@given(seed=st.integers(0, 2**32 - 1))
def test_equals_host(x64, options, seed):
    points, members = make_generic(np.random.default_rng(seed), 6)
    points = points.astype(np.float64)
    twin, host = (solve(solver, options, points, members) for solver in ("jax", "host"))
    assert (twin[0].dtype, twin[1].dtype) == (np.int32, np.float64)
    np.testing.assert_array_equal(twin[0], host[0])
    np.testing.assert_allclose(twin[1], host[1], atol=CENTER_ROUNDING)


@pytest.mark.parametrize("options", [PARTS, RINGS])
def test_single_precision_equals_host(options):
    """A point about as near to two centers may go to either: at most 1 of 100 sets has one."""
    num_equal = 0
    for seed in range(50):
        points, members = make_generic(np.random.default_rng(seed), 6)
        twin, host = (solve(solver, options, points, members) for solver in ("jax", "host"))
        equal = (np.asarray(twin[0]) == np.asarray(host[0])).all(axis=1)
        num_equal += equal.sum()
        twin_centers, host_centers = np.asarray(twin[1])[equal], np.asarray(host[1])[equal]
        np.testing.assert_allclose(twin_centers, host_centers, atol=CENTER_ROUNDING)
    assert num_equal >= 0.99 * 50 * 6


@pytest.mark.parametrize("size", [1, 63, 64, 65, 128, 160])
def test_sets_fill_one_block_of_rows_or_several(size):
    points, _ = make_generic(np.random.default_rng(size), 1)
    members = np.zeros((6, NUM_POINTS), bool)
    members[0, :size] = True
    members[1:5, 3:9] = True
    labels, _ = solve("jax", PARTS, points, members)
    np.testing.assert_array_equal(labels, solve("host", PARTS, points, members)[0])


@given(seed=st.integers(0, 2**32 - 1), distinct=st.integers(1, 4))
def test_degenerate_sets_equal_host(seed, distinct):
    """At most K distinct whole-number points: distances and means are exact, draws decide."""
    rng = np.random.default_rng(seed)
    kinds = rng.integers(-3, 4, (distinct, DIM))
    points = kinds[rng.integers(0, distinct, NUM_POINTS)].astype(np.float32)
    members = rng.random((6, NUM_POINTS)) < rng.choice([0.01, 0.03, 0.5], (6, 1))
    labels, centers = solve("jax", PARTS, points, members)
    host_labels, host_centers = solve("host", PARTS, points, members)
    np.testing.assert_array_equal(labels, host_labels)
    np.testing.assert_array_equal(centers, host_centers)


def test_few_points_get_a_cluster_each():
    points, _ = make_generic(np.random.default_rng(3), 1)
    members = np.zeros((6, NUM_POINTS), bool)
    for size in range(5):
        members[size, 20 : 20 + size] = True
    labels = np.asarray(solve("jax", PARTS, points, members)[0])
    for size in range(5):
        assert sorted(labels[size, members[size]]) == list(range(size))
    assert (labels[~members] == NO_SLOT).all()


def test_every_set_has_its_own_number_of_clusters():
    points, members = make_generic(np.random.default_rng(4), 6)
    members[:] = True
    wanted = np.array([1, 2, 3, 9, 16, 24])
    labels, centers = solve("jax", RINGS, points, members, wanted)
    host_labels, host_centers = solve("host", RINGS, points, members, wanted)
    np.testing.assert_array_equal(labels, host_labels)
    np.testing.assert_allclose(centers, host_centers, atol=CENTER_ROUNDING)
    assert (np.asarray(labels).max(axis=1) < wanted).all()
    assert not np.asarray(centers)[0, 1:].any()


def test_batch_equals_host():
    rng = np.random.default_rng(5)
    cases = [make_generic(rng, 6) for _ in range(8)]
    points, members = map(np.stack, zip(*cases, strict=True))
    host, twin = (
        jax.jit(jax.vmap(lambda p, m, s=solver: kmeans(p, m, **PARTS, solver=s)))(points, members)
        for solver in ("host", "jax")
    )
    np.testing.assert_array_equal(twin[0], host[0])


@pytest.mark.parametrize("seed", [0, 1])
def test_draws_equal_numpy(seed):
    counts = np.array([1, 2, 3, 17, 600, 3600, 65537, 2**31 - 1])
    numbers = _draw_numbers(jnp.asarray(counts, jnp.int32), seed, 264)
    for count, drawn in zip(counts, np.asarray(numbers), strict=True):
        stream = np.random.Generator(np.random.PCG64(seed))
        np.testing.assert_array_equal(drawn, [stream.integers(0, count) for _ in range(264)])


def test_rejected_words_are_skipped():
    """Near 3/4 of 2^31 every fourth word or so is rejected; NumPy is the judge."""
    count = 2**31 - 2**29 + 1
    stream = np.random.Generator(np.random.PCG64(0))
    expected = [int(stream.integers(0, count)) for _ in range(8)]
    drawn = np.asarray(_draw_numbers(jnp.asarray([count], jnp.int32), 0, 64))[0, :8]
    assert drawn.tolist() == expected


def test_unknown_solver_is_named():
    with pytest.raises(ConfigError, match="'gpu' is unknown; use 'host' or 'jax'"):
        kmeans(jnp.zeros((2, 2)), jnp.ones((1, 2), bool), **PARTS, solver="gpu")
