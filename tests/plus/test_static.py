"""Crowds: memory grows with the detections of a frame, not with their square, and is foretold."""

import functools

import jax
import numpy as np
import pytest

from remind_jax.plus.state import init
from remind_jax.plus.static import count_bytes
from remind_jax.plus.thresholds import PlusThresholds
from remind_jax.plus.tracker import advance
from remind_jax.static import Static
from tests.plus import frames

DIM = 177


@functools.cache
def used(detections: int, objects: int) -> tuple[int, int]:
    """Bytes of the memory, and of what the compiled step needs for the time being."""
    static = Static(num_detections=detections, num_objects=objects, feature_dim=DIM)
    seen = frames.detections(np.zeros((detections, 2)), np.zeros((detections, DIM)))
    step = functools.partial(advance, static=static, thresholds=PlusThresholds())
    state = init(static)
    compiled = (
        jax.jit(step, donate_argnums=0).lower(state, seen, frames.motion(), seen.valid).compile()
    )
    memory = compiled.memory_analysis()
    if memory is None:
        pytest.skip("this compiler does not tell how much memory a program needs")
    return sum(leaf.nbytes for leaf in jax.tree.leaves(state)), int(memory.temp_size_in_bytes)


@pytest.mark.slow
def test_twice_the_detections_take_about_twice_the_memory(optimized):
    _, some = used(256, 512)
    _, twice = used(512, 512)
    assert twice < 2.3 * some, (some, twice)


@pytest.mark.slow
@pytest.mark.parametrize("sizes", [(16, 64), (256, 512), (512, 512)])
def test_what_is_foretold_is_enough_and_not_twice_what_is_needed(optimized, sizes):
    detections, objects = sizes
    static = Static(num_detections=detections, num_objects=objects, feature_dim=DIM)
    needed = sum(used(detections, objects))
    assert needed <= count_bytes(static) < 2 * needed
