"""Detections of a frame: pooled looks and backgrounds, lengths that do not depend on its size."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from remind_jax.masks.reduction import reduce_masks
from remind_jax.observation import CloseupFeats, FrameFeats
from remind_jax.plus.observation import Motion, observe

OBSERVE = jax.jit(observe)


def seen(scale: int = 1, value: float = 1.0, unit_patches: bool = False, shift=(0.0, 0.0)):
    """A square of one feature before another, in a frame of 48 x 64 pixels times `scale`."""
    height, width, patch = 48 * scale, 64 * scale, 8 * scale
    mask = np.zeros((1, height, width), bool)
    mask[0, 16 * scale : 32 * scale, 16 * scale : 32 * scale] = True
    patches = np.tile(np.array([0.0, 1.0], np.float32), (6, 8, 1))
    patches[2:4, 2:4] = [value, 0.0]
    feats = FrameFeats(jnp.asarray(patches), jnp.array([height, width]))
    masks = reduce_masks(mask, np.zeros(1, np.int32), np.ones(1), num_slots=2, patch_px=patch)
    matrix = np.concatenate([np.eye(2), np.reshape(shift, (2, 1))], axis=1)
    motion = Motion(
        jnp.asarray(matrix, jnp.float32), jnp.float32(1), jnp.array([height, width]), jnp.float32(1)
    )
    return OBSERVE(feats, masks, motion, jnp.array(unit_patches))


def test_looks_are_of_the_object_and_rings_of_what_surrounds_it():
    sightings, _ = seen()
    np.testing.assert_allclose(sightings.look[0], [1.0, 0.0], atol=1e-6)
    np.testing.assert_allclose(sightings.ring[0], [0.0, 1.0], atol=1e-6)
    assert sightings.valid.tolist() == [True, False]
    assert sightings.has_ring.tolist() == [True, False]


def test_a_look_has_its_background_in_the_channels_that_tell_of_it():
    patches = np.zeros((1, 6, 6, 4), np.float32)
    patches[..., :2], patches[..., 2:] = [0.0, 1.0], [0.0, 5.0]
    patches[0, 2:4, 2:4] = [1.0, 0.0, 5.0, 0.0]
    coverage = np.zeros((1, 6, 6), np.float32)
    coverage[0, 2:4, 2:4] = 1.0
    is_background = np.array([False, False, True, True])
    masks = reduce_masks(
        np.ones((1, 48, 64), bool), np.zeros(1, np.int32), np.ones(1), num_slots=1, patch_px=8
    )
    changes = np.array([[0.0, 0.1, 0.0, 0.2]], np.float32)
    feats = CloseupFeats(patches, coverage, is_background, changes, np.array([48, 64]))
    still = Motion(jnp.eye(2, 3), jnp.float32(1), jnp.array([48, 64], jnp.int32), jnp.float32(1))
    sightings, _ = OBSERVE(feats, masks, still, jnp.array(False))
    np.testing.assert_allclose(sightings.look[0], [1.0, 0.0, 0.0, 5.0], atol=1e-6)
    np.testing.assert_allclose(sightings.ring[0], [0.0, 0.0, 0.0, 5.0], atol=1e-6)
    assert sightings.is_background.tolist() == is_background.tolist()
    assert sightings.light_changes.tolist() == changes.tolist()


@pytest.mark.parametrize("scale", [2, 5])
def test_lengths_do_not_depend_on_the_size_of_the_frame(scale):
    small, moved = seen(shift=(8.0, 0.0))
    large, moved_large = seen(scale, shift=(8.0 * scale, 0.0))
    np.testing.assert_allclose(small.frame_center, large.frame_center, rtol=1e-5)
    for name in ("box", "size"):  # an empty slot has no size
        np.testing.assert_allclose(getattr(small, name)[0], getattr(large, name)[0], rtol=1e-5)
    # Centers are means of pixel indices, half a pixel off the middle of the area.
    np.testing.assert_allclose(small.center[0], large.center[0], atol=0.06)
    np.testing.assert_allclose(moved.matrix, moved_large.matrix, rtol=1e-6)


@pytest.mark.parametrize("value", [np.nan, np.inf, 1e20])  # the last one cannot be squared
def test_patches_that_are_not_usable_are_left_out_and_counted(value):
    sightings, _ = seen(value=value)
    assert sightings.num_bad_patches == 4
    assert not sightings.valid.any()
    assert np.isfinite(sightings.look).all()


def test_lengths_of_features_count_unless_patches_are_scaled():
    np.testing.assert_allclose(seen(value=5.0)[0].look[0, 0], 5.0, rtol=1e-6)
    np.testing.assert_allclose(seen(value=5.0, unit_patches=True)[0].look[0, 0], 1.0, rtol=1e-6)


def test_a_frame_of_zeros_is_one_without_detections_that_goes_on():
    feats = FrameFeats(np.zeros((6, 8, 2), np.float32), np.zeros(2, np.int32))
    masks = reduce_masks(
        np.zeros((0, 48, 64), bool), np.zeros(0, np.int32), np.zeros(0), num_slots=2, patch_px=8
    )
    zeros = jax.tree.map(np.zeros_like, (feats, masks, seen()[1]))
    sightings, motion = OBSERVE(*zeros, jnp.array(True))
    assert not sightings.valid.any()
    assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves((sightings, motion)))
    np.testing.assert_array_equal(motion.matrix, np.eye(2, 3))
