"""Rotary tables and resampled position tables against recorded ones."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
import pytest

from remind_jax.backbone.vit_positions import (
    resample_table,
    resampling_matrix,
    rotary_periods,
    rotary_tables,
    rotate,
)
from tests.golden.vit import load as golden
from tests.golden.vit import weights as formulas

# Angles reach 2 pi in float32; sine and cosine carry that rounding on.
ROTARY = 1e-6
# PyTorch rounds coordinates to float32, on a table of amplitude 0.8.
TABLES = 2e-6

ROPE = dict(np.load(golden.ROOT / "rope.npz"))
RESAMPLED = dict(np.load(golden.ROOT / "pos_interp.npz"))


def test_periods():
    np.testing.assert_allclose(rotary_periods(64), ROPE["periods_torch"], rtol=2e-7)


@pytest.mark.parametrize("kind", ["fp32", "bf16"])
def test_rotary_tables(kind):
    periods = jnp.asarray(ROPE[f"periods_{kind}"])
    for found, name in zip(rotary_tables(3, 5, periods), ("sin", "cos"), strict=True):
        assert np.abs(found - ROPE[f"separate/{kind}/{name}"]).max() < ROTARY
    for found, name in zip(rotary_tables(45, 80, periods), ("sin_rows", "cos_rows"), strict=True):
        stored = ROPE[f"separate/{kind}/45x80/{name}"]
        assert np.abs(found[::400] - stored).max() < ROTARY


def test_rotation_turns_halves_against_each_other():
    """A quarter turn takes the first half to the second and the second to minus the first."""
    token = np.arange(8.0).reshape(1, 8)
    turned = rotate(token, np.ones((1, 8)), np.zeros((1, 8)))
    np.testing.assert_array_equal(turned, [[-4, -5, -6, -7, 0, 1, 2, 3]])


@pytest.mark.parametrize("key", sorted(RESAMPLED))
def test_resampled_tables(key):
    rule, side, grid = key.split("/")
    rows, columns = map(int, grid.split("x"))
    num = int(side) ** 2
    table = formulas.tensor("pos_embed", (1, num + 1, 8))[0, 1:, :2]
    table = table.reshape(int(side), int(side), 2)
    found = resample_table(jnp.asarray(table), rows, columns, rule)
    assert np.abs(found - RESAMPLED[key]).max() < TABLES


@pytest.mark.parametrize("rule", ["offset", "size", "antialias"])
@pytest.mark.parametrize(("num_out", "num_in"), [(3, 37), (80, 14), (5, 5)])
def test_a_constant_table_stays_constant(rule, num_out, num_in):
    rows = resampling_matrix(num_out, num_in, rule).astype(np.float64).sum(axis=1)
    np.testing.assert_allclose(rows, 1.0, atol=1e-6)  # float32 weights


def test_a_square_grid_of_the_same_size_is_taken_as_it_is():
    table = jnp.asarray(formulas.tensor("pos_embed", (5, 5, 2)))
    for rule in ("offset", "size", "antialias"):
        assert resample_table(table, 5, 5, rule) is table
