"""The twin must choose the pairs that SciPy chooses, ties included.

Tied scores are tenths: in single precision their sums round, and ties would fall otherwise than in
SciPy's double precision.
"""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import linear_sum_assignment

from remind_jax.errors import ConfigError
from remind_jax.numerics.absent import NO_SLOT
from remind_jax.solvers.assignment import assign, assign_groups

SHAPES = ((1, 1), (6, 4), (16, 24))


def solve(*problem):
    return assign(*problem, solver="jax")


twin = jax.jit(solve)


def by_scipy(scores, allowed, group, dummy, dummies):
    return assign_groups(scores, allowed, group, dummy, bool(dummies))


def make_problem(rng, num, columns, dtype: type = np.float32):
    """Random or tied scores, shared or separate columns, rows and columns without pairs."""
    scores = rng.random((num, columns))
    if rng.random() < 0.6:
        scores = np.round(scores * rng.choice([2, 4, 10])) / 10
    groups = rng.integers(1, 2 + num // 2)
    group = rng.integers(0, groups, num) - 2
    allowed = rng.random((num, columns)) < rng.choice([0, 0.1, 0.3, 0.6, 1.0])
    if rng.random() < 0.5:
        allowed &= group[:, None] == rng.integers(0, groups, columns) - 2
    allowed[rng.random(num) < 0.15] = False
    allowed[:, rng.random(columns) < rng.choice([0, 0.3, 0.8])] = False
    dummy = rng.choice([0.05, 0.1, 0.3, 0.7], num) if rng.random() < 0.5 else rng.random(num)
    dummies = rng.random() < 0.5
    return (
        scores.astype(dtype),
        allowed,
        group.astype(np.int32),
        dummy.astype(dtype),
        np.bool_(dummies),
    )


@pytest.mark.parametrize(("num", "columns"), SHAPES)
@given(seed=st.integers(0, 2**32 - 1))
def test_equals_scipy_pair_by_pair(num, columns, seed):
    problem = make_problem(np.random.default_rng(seed), num, columns)
    np.testing.assert_array_equal(twin(*problem), by_scipy(*problem))


@pytest.mark.parametrize(("num", "columns"), SHAPES[1:])
@given(seed=st.integers(0, 2**32 - 1))
def test_columns_that_no_row_may_have_count_among_ties(num, columns, seed):
    """The matrix of a group may be wider than what is allowed in it."""
    rng = np.random.default_rng(seed)
    problem = make_problem(rng, num, columns)
    shared = problem[2][:, None] == rng.choice(problem[2], columns)
    present = problem[1] | shared
    expected = assign_groups(*problem[:4], bool(problem[4]), present)
    np.testing.assert_array_equal(twin(*problem, present), expected)


@pytest.mark.parametrize(
    ("num", "columns", "dtype"), [*((*shape, np.float32) for shape in SHAPES), (8, 6, np.float64)]
)
def test_batch_equals_scipy(num, columns, dtype):
    rng = np.random.default_rng(7)
    problems = [make_problem(rng, num, columns, dtype) for _ in range(200)]
    with jax.enable_x64(dtype is np.float64):
        batch = [jnp.asarray(np.stack(part)) for part in zip(*problems, strict=True)]
        result = jax.jit(jax.vmap(solve))(*batch)
    assert (batch[0].dtype, result.dtype) == (dtype, np.int32)
    np.testing.assert_array_equal(result, [by_scipy(*p) for p in problems])


@pytest.mark.parametrize("shape", SHAPES[1:])
def test_one_group_is_one_call_of_scipy(shape):
    rng = np.random.default_rng(9)
    for _ in range(30):
        scores = rng.integers(0, 4, shape).astype(np.float32)
        rows, columns = linear_sum_assignment(scores, maximize=True)
        expected = np.full(shape[0], NO_SLOT)
        expected[rows] = columns
        everything = np.ones(shape, bool)
        one_group, dummy = np.zeros(shape[0], np.int32), np.zeros(shape[0], np.float32)
        result = twin(scores, everything, one_group, dummy, np.bool_(False))
        np.testing.assert_array_equal(result, expected)


def test_invalid_score_ends():
    """SciPy refuses such a table; the twin leaves rows without a column, and comes back."""
    scores = np.full((6, 4), np.nan, np.float32)
    rest = np.ones((6, 4), bool), np.zeros(6, np.int32), np.zeros(6, np.float32), np.bool_(False)
    assert twin(scores, *rest).tolist() == [NO_SLOT] * 6


@pytest.mark.parametrize("swept", [False, True])
def test_both_solvers_agree_under_transformations(swept):
    rng = np.random.default_rng(10)
    problems = [make_problem(rng, 6, 4) for _ in range(16)]
    batch = [np.stack(part) for part in zip(*problems, strict=True)]
    axes = (0, 0, 0, 0, 0 if swept else None)
    if not swept:
        batch[4] = batch[4][0]
    host, twin_ = (
        jax.jit(jax.vmap(jax.jit(lambda *p, s=solver: assign(*p, solver=s)), in_axes=axes))(*batch)
        for solver in ("host", "jax")
    )
    np.testing.assert_array_equal(host, twin_)
    if swept:
        scanned = jax.lax.map(lambda p: solve(*p), tuple(map(jnp.asarray, batch)))
        np.testing.assert_array_equal(scanned, host)


def test_unknown_solver_is_named():
    problem = make_problem(np.random.default_rng(0), 1, 1)
    with pytest.raises(ConfigError, match="'scipy' is unknown; use 'host' or 'jax'"):
        assign(*map(jnp.asarray, problem), solver="scipy")


@pytest.mark.parametrize("solver", ["jax", "host"])
def test_who_gets_what_has_no_derivative(solver):
    problem = make_problem(np.random.default_rng(0), 6, 4)

    def taken(scores):
        column = assign(scores, *problem[1:], solver=solver)
        return jnp.sum(
            jnp.where(
                column == NO_SLOT,
                0.0,
                jnp.take_along_axis(scores, jnp.maximum(column, 0)[:, None], axis=1)[:, 0],
            )
        )

    slope = jax.grad(taken)(problem[0])
    assert set(np.unique(slope)) <= {0.0, 1.0}
    assert slope.sum() == np.sum(np.asarray(twin(*problem)) != NO_SLOT)
