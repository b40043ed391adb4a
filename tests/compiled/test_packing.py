"""Packed trees: the same leaves again, on the host, on the device and under jit."""

import chex
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from remind_jax.compiled.packing import SMALL_BYTES, Bundle, Packed

DTYPES = st.sampled_from([np.bool_, np.int32, np.float32, np.uint8])
LEAVES = DTYPES.flatmap(lambda d: hnp.arrays(d, hnp.array_shapes(min_dims=0, min_side=0)))
TREES = st.recursive(
    LEAVES | st.none(), lambda children: st.lists(children) | st.tuples(children, children)
)


def assert_same(one, other):
    chex.assert_trees_all_equal(one, other, strict=True)


@given(TREES)
def test_unpacking_gives_the_tree_back(tree):
    packed = Packed.of(tree)
    assert_same(packed.unpack(), tree)
    assert len(packed.vectors) == len({leaf.dtype for leaf in jax.tree.leaves(tree)})


def test_a_program_unpacks_and_packs():
    tree = {"gate": np.array(True), "scores": np.arange(6, dtype=np.float32).reshape(2, 3)}
    double = jax.jit(lambda p: Packed.of(jax.tree.map(lambda leaf: leaf * 2, p.unpack())))
    doubled = jax.device_get(double(Packed.of(tree))).unpack()
    np.testing.assert_array_equal(doubled["scores"], 2 * tree["scores"])
    assert doubled["gate"].dtype == np.int32
    assert doubled["gate"] == 2


def test_a_bundle_joins_what_is_small():
    large = np.arange(SMALL_BYTES // 4, dtype=np.float32)
    tree = {"ids": np.arange(3, dtype=np.int32), "large": large, "seen": np.array([True, False])}
    bundle = Bundle.of(tree)
    assert len(jax.tree.leaves(bundle)) == 3
    assert bundle.large[0] is large
    assert_same(bundle.unpack(), tree)
    later = jax.jit(lambda b: Bundle.of(jax.tree.map(lambda leaf: ~leaf, b.unpack()["seen"])))
    np.testing.assert_array_equal(later(bundle).read(), [False, True])


def test_what_was_read_of_a_bundle_outlives_it():
    step = jax.jit(lambda b: Bundle.of(b.unpack() + 1), donate_argnums=0)
    before = step(Bundle.of(np.zeros(3, np.float32)))
    read = before.read()
    assert step(before).read().tolist() == [2, 2, 2]
    assert read.tolist() == [1, 1, 1]


def test_numbers_take_the_precision_that_jax_has():
    packed = Packed.of((np.arange(3.0), 1, jnp.ones(2)))
    wide = jax.config.read("jax_enable_x64")
    assert set(packed.vectors) == ({"float64", "int64"} if wide else {"float32", "int32"})


@pytest.mark.parametrize("value", [1, 2])
def test_one_program_whatever_the_values(value):
    packed = Packed.of((np.float32(value), np.full(3, value, np.int32)))
    assert packed.layout == Packed.of((np.float32(0), np.zeros(3, np.int32))).layout
