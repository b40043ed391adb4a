"""Rotary tables and resampled position tables against recorded ones."""

import jax.numpy as jnp
import numpy as np
import pytest

from remind_jax.backbone.vit_positions import resample_table, rotary_tables
from tests.golden.vit import load as golden
from tests.golden.vit import weights as formulas

# Angles reach 2 pi in float32; sine and cosine carry that rounding on.
ROTARY = 1e-6
# PyTorch rounds coordinates to float32, on a table of amplitude 0.8.
TABLES = 2e-6

ROPE = dict(np.load(golden.ROOT / "rope.npz"))
RESAMPLED = dict(np.load(golden.ROOT / "pos_interp.npz"))


@pytest.mark.parametrize("kind", ["fp32", "bf16"])
def test_rotary_tables(kind):
    periods = jnp.asarray(ROPE[f"periods_{kind}"])
    for found, name in zip(rotary_tables(3, 5, periods), ("sin", "cos"), strict=True):
        assert np.abs(found - ROPE[f"separate/{kind}/{name}"]).max() < ROTARY
    for found, name in zip(rotary_tables(45, 80, periods), ("sin_rows", "cos_rows"), strict=True):
        stored = ROPE[f"separate/{kind}/45x80/{name}"]
        assert np.abs(found[::400] - stored).max() < ROTARY


@pytest.mark.parametrize("key", sorted(RESAMPLED))
def test_resampled_tables(key):
    rule, side, grid = key.split("/")
    rows, columns = map(int, grid.split("x"))
    num = int(side) ** 2
    table = formulas.tensor("pos_embed", (1, num + 1, 8))[0, 1:, :2]
    table = table.reshape(int(side), int(side), 2)
    found = resample_table(jnp.asarray(table), rows, columns, rule)
    assert np.abs(found - RESAMPLED[key]).max() < TABLES
