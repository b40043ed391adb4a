"""Places of objects out of view, and that rounding never breaks what is known of them."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np

from remind_jax.plus import scene_map
from remind_jax.plus.state import init
from tests.plus.frames import TICK, T, motion
from tests.plus.walls import STATIC, pan

CENTER = jnp.array([3.2, 2.4])
SIGHTINGS = jax.tree.map(lambda leaf: leaf[0], pan().sightings)
correct_map = jax.jit(scene_map.correct_map)


@jax.jit
def move(objects, pairs, shift, score, now):
    """The map after the image moved."""
    moved = motion(shift, score)
    return scene_map.move_map(objects, pairs, moved, CENTER, now, TICK, T.motion, T.mobility)


def memory(position: np.ndarray, covariance: np.ndarray):
    """Objects in the first slots of an empty memory."""
    state = init(STATIC)
    num, room = len(position), STATIC.num_objects
    objects = dataclasses.replace(
        state.objects,
        id=jnp.where(jnp.arange(room) < num, jnp.arange(room), -1),
        last=jnp.zeros(room, jnp.int32),
        position=state.objects.position.at[:num].set(position),
    )
    full = state.pairs.covariance.at[:num, :num].set(covariance)
    return objects, dataclasses.replace(state.pairs, covariance=full)


def test_places_move_with_the_image_and_doubt_grows_faster_without_trust():
    objects, pairs = memory(np.array([[1.0, 1.0], [9.0, 2.0]]), 0.01 * np.eye(2))
    moved, trusted = move(objects, pairs, (-0.5, 0.1), 0.9, jnp.int32(1))
    _, doubted = move(objects, pairs, (-0.5, 0.1), 0.0, jnp.int32(1))
    np.testing.assert_allclose(moved.position[:2], [[0.5, 1.1], [8.5, 2.1]], atol=1e-5)
    before, sure, unsure = (p.covariance[0, 0] for p in (pairs, trusted, doubted))
    assert before < sure < unsure
    assert trusted.covariance[0, 1] > 0  # one error moves all


def test_an_object_in_view_corrects_one_out_of_view():
    shared = np.array([[1.0, 0.99], [0.99, 1.0]])
    objects, pairs = memory(np.array([[1.0, 1.0], [9.0, 2.0]]), shared)
    seen = jnp.asarray(SIGHTINGS.center).at[0].set(jnp.array([1.5, 1.0]))
    sightings = dataclasses.replace(SIGHTINGS, center=seen)
    sure = jnp.arange(len(seen)) == 0
    slot = jnp.zeros(len(seen), jnp.int32)
    after, left = correct_map(objects, pairs, slot, sure, sure, sightings)
    # Nearly all of the error is shared, so the other moves nearly as far.
    np.testing.assert_allclose(after.position[1], [9.5, 2.0], atol=0.05)
    assert left.covariance[1, 1] < 0.1


def test_rounding_leaves_a_covariance_through_years_of_doubt():
    rng = np.random.default_rng(0)
    num = 12
    objects, pairs = memory(rng.uniform(-20, 20, (num, 2)), 0.01 * np.eye(num))
    slots = STATIC.num_detections

    @jax.jit
    def frame(objects, pairs, moved, now, chosen, score):
        objects, pairs = move(objects, pairs, moved, score, now)
        sure = jnp.arange(slots) < 4
        place = objects.position[chosen] + 0.05
        seen = dataclasses.replace(SIGHTINGS, center=place)
        objects = dataclasses.replace(objects, last=objects.last.at[chosen].set(now))
        return correct_map(objects, pairs, chosen, sure, sure, seen)

    for now in range(1, 400):
        chosen = jnp.asarray(rng.choice(num, slots, replace=False), jnp.int32)
        moved = jnp.asarray(rng.normal(0, 1, 2), jnp.float32)
        objects, pairs = frame(objects, pairs, moved, jnp.int32(now), chosen, jnp.float32(now % 2))
    covariance = np.asarray(pairs.covariance)[:num, :num]
    own = np.diag(covariance)
    assert np.all(np.isfinite(covariance))
    assert np.all(np.isfinite(objects.position))
    assert np.all(own > 0)
    # Correlations are clipped at one; float32 division may round up by one part in 10 million.
    assert np.all(np.abs(covariance) <= np.sqrt(np.outer(own, own)) * (1 + 1e-6))


def test_detections_in_blocks_correct_the_map_as_one_after_the_other(monkeypatch):
    rng = np.random.default_rng(1)
    num, slots = 9, STATIC.num_detections
    root = rng.normal(size=(num, num))
    objects, pairs = memory(rng.uniform(0, 5, (num, 2)), root @ root.T / num)
    slot = jnp.asarray(rng.permutation(slots) % num, jnp.int32)
    sure = (jnp.arange(slots) < num) & (jnp.arange(slots) != 1)
    center = objects.position[slot] + jnp.asarray(rng.normal(0, 0.1, (slots, 2)), jnp.float32)
    sightings = dataclasses.replace(SIGHTINGS, center=center)

    def correct():
        given = lambda *leaves: scene_map.correct_map(*leaves)  # noqa: E731  (traced anew)
        return jax.jit(given)(objects, pairs, slot, sure, sure, sightings)

    at_once = correct()
    monkeypatch.setattr(scene_map, "BLOCK", 4)
    assert slots > scene_map.BLOCK
    assert slots % scene_map.BLOCK, "the last block shall not be full"
    in_blocks = correct()
    for one, other in zip(at_once, in_blocks, strict=True):
        jax.tree.map(lambda x, y: np.testing.assert_allclose(x, y, atol=2e-5), one, other)
    # The same as by the textbook, one detection after the other.
    position, covariance = np.array(objects.position), np.array(pairs.covariance, np.float64)
    measured = np.asarray(scene_map.center_variance(sightings.size, sightings.touches))
    for row in np.flatnonzero(sure):
        place = int(slot[row])
        gain = covariance[place] / (covariance[place, place] + measured[row])
        position = position + gain[:, None] * (np.asarray(center[row]) - position[place])
        covariance = covariance - np.outer(gain, covariance[place])
    np.testing.assert_allclose(in_blocks[0].position, position, atol=1e-4)
    np.testing.assert_allclose(in_blocks[1].covariance, covariance, atol=1e-4)
