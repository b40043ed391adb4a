"""Points, vectors and sizes in the image plane, beside NumPy."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
import pytest

from remind_jax.plus.plane import (
    area_of,
    log_ratios,
    mean_sizes,
    squared_length,
    turned,
    zoom_of,
)

RNG = np.random.default_rng(0)
POINTS = RNG.normal(size=(3, 4, 2)).astype(np.float32)
TURN = np.array([[1.2, -0.5], [0.4, 0.9]], np.float32)
SIZES = np.array([0.2, 1.0, 3.0], np.float32)


def test_lengths_and_areas():
    np.testing.assert_allclose(squared_length(POINTS), np.sum(POINTS**2, axis=-1), rtol=1e-6)
    np.testing.assert_allclose(area_of(POINTS), np.prod(POINTS, axis=-1), rtol=1e-6)


def test_points_turn_and_lengths_zoom():
    np.testing.assert_allclose(turned(POINTS, jnp.asarray(TURN)), POINTS @ TURN.T, atol=1e-6)
    np.testing.assert_allclose(zoom_of(jnp.asarray(TURN)), np.sqrt(np.linalg.det(TURN)), rtol=1e-6)


@pytest.mark.parametrize("right", [SIZES, SIZES[:2]])
def test_sizes_are_compared_in_pairs(right):
    ratios = np.log(SIZES[:, None] / right[None])
    np.testing.assert_allclose(log_ratios(SIZES, right), ratios, atol=1e-6)
    np.testing.assert_allclose(
        mean_sizes(SIZES, right), np.sqrt(SIZES[:, None] * right[None]), rtol=1e-6
    )
