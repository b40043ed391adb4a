"""The memory as a pytree: growing keeps everything, and no two leaves share a buffer."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from remind_jax.remind.method import METHOD
from remind_jax.remind.state import TrackerState, init
from tests.statics import change_static
from tests.tiny_world import STATIC

WIDEST = change_static(STATIC, num_detections=9, num_objects=17, num_pending=12)


def fill(state: TrackerState) -> TrackerState:
    """A memory in which every number is another one; nothing in it is consistent."""
    rng = np.random.default_rng(0)

    def draw(leaf: jax.Array) -> jax.Array:
        if leaf.dtype == bool:
            return jnp.asarray(rng.random(leaf.shape) < 0.5)
        return jnp.asarray(rng.integers(1, 1 << 20, leaf.shape), leaf.dtype)

    return jax.tree.map(draw, state)


def test_growing_keeps_everything():
    small, empty = fill(init(STATIC)), init(WIDEST)
    large = METHOD.enlarge(small, WIDEST)
    assert jax.tree.map(jnp.shape, large) == jax.tree.map(jnp.shape, empty)
    objects, pending = STATIC.num_objects, STATIC.num_pending
    for name in ("wholes", "parts"):
        before, after = jax.tree.leaves(getattr(small, name)), jax.tree.leaves(getattr(large, name))
        for old, new in zip(before, after, strict=True):
            np.testing.assert_array_equal(new[:, :, :objects], old[:, :, :objects])
            moved = new[:, :, WIDEST.num_objects : WIDEST.num_objects + pending]
            np.testing.assert_array_equal(moved, old[:, :, objects:])
    rest = [
        dataclasses.replace(state, wholes=None, parts=None, overflow=None)
        for state in (small, large)
    ]
    for old, new in zip(*map(jax.tree.leaves, rest), strict=True):
        np.testing.assert_array_equal(new[tuple(map(slice, old.shape))], old)


@pytest.mark.parametrize("make", [init, lambda static: METHOD.enlarge(fill(init(STATIC)), static)])
def test_no_two_leaves_share_a_buffer(make):
    """Each is donated to the step, which may happen only once."""
    leaves = jax.tree.leaves(make(WIDEST))
    pointers = {
        leaf.ctypes.data if isinstance(leaf, np.ndarray) else leaf.unsafe_buffer_pointer()
        for leaf in leaves
    }
    assert len(pointers) == len(leaves)


def test_banks_are_read_by_kind():
    """As notebook 02 shows them."""
    state = fill(init(STATIC))
    num, kinds = state.appearance.size.shape[1], (state.wholes, state.appearance, state.rings)
    for both, appearance, rings in zip(*map(jax.tree.leaves, kinds), strict=True):
        np.testing.assert_array_equal(both[:, :num], appearance)
        np.testing.assert_array_equal(both[:, num:], rings)
