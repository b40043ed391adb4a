"""Inverses and bases of small matrices."""

import jax.numpy as jnp
import numpy as np
import pytest

from remind_jax.plus.small_matrices import invert, orthonormalize


@pytest.mark.parametrize("size", [1, 5, 40])
def test_inverse_of_a_positive_matrix(size):
    rng = np.random.default_rng(size)
    root = rng.normal(size=(size, size)).astype(np.float32)
    matrix = root @ root.T + 0.1 * np.trace(root @ root.T) / size * np.eye(size, dtype=np.float32)
    # Condition numbers reach some hundreds, which cost two or three of seven digits.
    np.testing.assert_allclose(invert(jnp.asarray(matrix)) @ matrix, np.eye(size), atol=1e-4)


def test_basis_is_orthonormal_and_spans_the_same():
    columns = np.random.default_rng(0).normal(size=(30, 6)).astype(np.float32) * 10.0 ** np.arange(
        6
    )
    basis = np.asarray(orthonormalize(jnp.asarray(columns)))
    # The jitter of 1e-5 that keeps dependent columns apart shows in the lengths.
    np.testing.assert_allclose(basis.T @ basis, np.eye(6), atol=1e-3)
    rest = columns - basis @ (basis.T @ columns)
    assert np.all(np.linalg.norm(rest, axis=0) < 1e-3 * np.linalg.norm(columns, axis=0))


def test_dependent_columns_stay_finite():
    column = np.ones((5, 1), np.float32)
    assert np.all(np.isfinite(orthonormalize(jnp.asarray(np.hstack([column, column, 0 * column])))))
