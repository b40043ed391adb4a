import jax
import jax.numpy as jnp
import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from remind_jax.remind.perception.rings import INNER, find_rings, ring_weights
from remind_jax.remind.thresholds import Thresholds
from remind_jax.remind.thresholds.perception import Perception

MAX_RADIUS = 10
SHAPE = (9, 14)
FIND = jax.jit(find_rings, static_argnums=1)


def thresholds(**changes):
    rules = Thresholds(perception=Perception(**changes))
    return rules.as_arrays(jnp.float32).perception


def grid(shape, rows, columns):
    patches = np.zeros(shape, bool)
    patches[rows, columns] = True
    return patches


def chebyshev(patches):
    """Distance of every patch to the nearest patch of the object, by brute force."""
    at = np.argwhere(patches)
    index = np.stack(np.meshgrid(*map(np.arange, patches.shape), indexing="ij"), -1)
    if not len(at):
        return np.full(patches.shape, 10**6)
    return np.abs(index[:, :, None] - at).max(-1).min(-1)


def rings_by_loops(patches, t: Perception):
    """method.md#rings word for word."""
    distance = chebyshev(patches)
    border = t.ring_border
    inner_edge, limit = max(t.ring_inner, border), max(t.ring_outer, t.ring_limit)

    def ring(low, high):
        return (distance > low) & (distance <= high)

    while (
        t.ring_adaptive and ring(border, inner_edge).sum() < t.ring_min_inner and inner_edge < limit
    ):
        inner_edge += 1
    outer_edge = max(t.ring_outer, t.ring_inner, inner_edge)
    low = border if t.ring_nested else inner_edge
    while t.ring_adaptive and ring(low, outer_edge).sum() < t.ring_min_outer and outer_edge < limit:
        outer_edge += 1
    return np.stack([ring(border, inner_edge), ring(low, outer_edge)])


@given(
    seed=st.integers(0, 2**32 - 1),
    density=st.sampled_from([0.0, 0.01, 0.1, 0.6]),
    rules=st.fixed_dictionaries(
        {
            "ring_border": st.integers(0, 3),
            "ring_inner": st.integers(0, 6),
            "ring_outer": st.integers(0, 9),
            "ring_limit": st.integers(0, MAX_RADIUS),
            "ring_min_inner": st.integers(0, 40),
            "ring_min_outer": st.integers(0, 60),
            "ring_nested": st.booleans(),
            "ring_adaptive": st.booleans(),
        }
    ),
)
def test_rings_equal_loops_over_all_settings(seed, density, rules):
    patches = np.random.default_rng(seed).random((2, *SHAPE)) < density
    rings = np.asarray(FIND(patches, MAX_RADIUS, thresholds(**rules)))
    for patch, found in zip(patches, rings, strict=True):
        np.testing.assert_array_equal(found, rings_by_loops(patch, Perception(**rules)))


def test_weights_are_the_share_of_background():
    rings = np.zeros((1, 2, 2, 2), bool)
    rings[0, INNER, 0] = True
    coverage = np.array([[[0.25, 1.0], [0.5, 0.5]]], np.float32)
    weights = np.asarray(ring_weights(jnp.asarray(rings), jnp.asarray(coverage)))
    np.testing.assert_array_equal(weights[0], [[0.75, 0, 0, 0], [0, 0, 0, 0]])
