"""How much can be told from each detection.

Rules: method.md#observation-quality, method.md#visual-score.
"""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from remind_jax.observation import Descriptors
from remind_jax.remind.association.quality import Quality, assess
from remind_jax.remind.thresholds.association import Similarity
from tests.statics import only

ASSESS = jax.jit(assess)
GOOD = {
    "num_patches": 40, "patch_sum": 40.0, "num_parts": 4, "part_support": 40.0, "inner": 20,
    "outer": 32, "mask_quality": 1.0,
}  # fmt: skip
THRESHOLDS = jax.tree.map(jnp.asarray, Similarity())
# Sums and quotients of a few float32.
CLOSE = 1e-6


def rate(t: Similarity = THRESHOLDS, **seen: float) -> Quality:
    """Quality of a detection that is large, dense and well surrounded but for what is given."""
    row = {name: np.array([value]) for name, value in {**GOOD, **seen}.items()}
    rings = np.stack([row.pop("inner"), row.pop("outer")], axis=1)
    row = {n: v.astype(np.int32 if n.startswith("num") else np.float32) for n, v in row.items()}
    descriptors = only(Descriptors, **row, ring_patches=rings.astype(np.int32))
    return jax.tree.map(lambda leaf: float(leaf[0]), ASSESS(descriptors, t))


@pytest.mark.parametrize(
    ("seen", "field", "expected"),
    [
        ({"patch_sum": 8.0, "num_patches": 8}, "object", 0.0),
        ({"patch_sum": 32.0, "num_patches": 32}, "object", 1.0),
        ({"patch_sum": 7.99, "num_patches": 8}, "parts", 0.0),  # too small for parts
        ({"patch_sum": 8.0, "num_patches": 8}, "parts", 2 / 3),  # but of many that cover it
        ({"num_patches": 0, "patch_sum": 0.0}, "object_density", 1.0),  # no patch, no doubt
        ({"num_patches": 40, "patch_sum": 6.0}, "object_density", 0.0),
        ({"inner": 8, "outer": 12, "mask_quality": 0.5}, "background", 0.0),
        ({"inner": 8, "outer": 12, "mask_quality": 1.0}, "background", 1 / 3),
        ({"num_parts": 0, "part_support": 0.0}, "parts", 1 / 3),
    ],
)
def test_edges(seen, field, expected):
    assert getattr(rate(**seen), field) == pytest.approx(expected, abs=CLOSE)


def test_switched_off_everything_is_perfect():
    off = dataclasses.replace(THRESHOLDS, quality_enabled=jnp.asarray(False))
    nothing = dict.fromkeys(GOOD, 0)
    assert all(value == 1.0 for value in dataclasses.astuple(rate(off, **nothing)))
