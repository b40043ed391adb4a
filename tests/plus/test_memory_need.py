"""Crowds: memory grows with the detections of a frame, not with their square, and is foretold."""

from __future__ import annotations

import functools

import jax
import jax.numpy as jnp
import pytest

from remind_jax.plus.memory_need import count_bytes
from remind_jax.plus.observation import Motion, Sightings
from remind_jax.plus.state import init
from remind_jax.plus.thresholds import PlusThresholds
from remind_jax.plus.tracker import advance
from remind_jax.static import Static

DIM = 177


@functools.cache
def used(detections: int, objects: int) -> tuple[int, int]:
    """Bytes of the memory, and of what the compiled step needs for the time being."""
    static = Static(num_detections=detections, num_objects=objects, feature_dim=DIM)
    real = functools.partial(jax.ShapeDtypeStruct, dtype=jnp.float32)
    whole = functools.partial(jax.ShapeDtypeStruct, dtype=jnp.int32)
    flag = functools.partial(jax.ShapeDtypeStruct, dtype=jnp.bool_)
    num = (detections,)
    sightings = Sightings(
        look=real((*num, DIM)),
        ring=real((*num, DIM)),
        has_ring=flag(num),
        box=real((*num, 4)),
        center=real((*num, 2)),
        size=real(num),
        patches=real(num),
        class_id=whole(num),
        touches=flag(num),
        valid=flag(num),
        frame_center=real((2,)),
        num_bad_patches=whole(()),
    )
    motion = Motion(real((2, 3)), real(()), whole((2,)), real(()))
    step = functools.partial(advance, static=static, thresholds=PlusThresholds())
    state = init(static)
    compiled = jax.jit(step, donate_argnums=0).lower(state, sightings, motion, flag(num)).compile()
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
