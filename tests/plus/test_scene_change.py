"""Another scene fades what was learned of looks, and only where looks are others than before."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from remind_jax.plus.scene_change import SAMPLES_LEFT, fade_cosines, is_another, looks_left
from remind_jax.plus.whitening import learn_scatter, sum_up
from remind_jax.static import Static
from tests.plus.frames import detections, empty_state, motion
from tests.plus.walls import Walk, follow

NUM, DIM, VISIT = 4, 32, 30
BEGINS = jnp.array([True, True, False])
FULL = jnp.ones(3)


@pytest.mark.parametrize(
    ("begin", "doubt", "expected"), [(3, 1.0, 1.0), (3, 0.5, 0.0), (1, 1.0, 0.0), (0, 1.0, 0.0)]
)
def test_another_scene_is_one_of_which_nothing_goes_on(begin, doubt, expected):
    begins, valid = jnp.arange(5) < begin, jnp.arange(5) < 3
    assert is_another(begins, valid, jnp.float32(doubt)) == pytest.approx(expected)


def test_a_frame_without_detections_is_no_other_scene():
    assert is_another(jnp.zeros(3, bool), jnp.zeros(3, bool), jnp.float32(1)) == 0


def learned_scene(num_frames: int = 60):
    """A scene after many looks around the middle of the first axis."""
    rng, scene = np.random.default_rng(0), empty_state().scene
    for frame in range(num_frames):
        look = np.array([3.0, 0.0, 0.0]) + rng.normal(size=(3, 3))
        seen = detections(np.zeros((3, 2)), look)
        nobody = jnp.zeros(3, bool)
        scene = learn_scatter(scene, seen, seen.look * 0, nobody, FULL, jnp.int32(frame))
    summed = sum_up(scene.total, scene.recent_looks, scene.looks_fade)
    return dataclasses.replace(scene, total=summed, looks_fade=jnp.full_like(scene.looks_fade, -1))


@pytest.mark.parametrize(("at", "is_strange"), [([3.0, 0.0, 0.0], False), ([3.0, 8.0, 0.0], True)])
def test_looks_count_on_unless_those_now_are_strange(at, is_strange):
    scene = learned_scene()
    seen = detections(np.zeros((3, 2)), np.array(at) + 0.1 * np.eye(3))
    left = looks_left(scene, seen, BEGINS, jnp.float32(1))
    expected = SAMPLES_LEFT / float(scene.total_weight) if is_strange else 1.0
    assert left == pytest.approx(expected, rel=1e-5)
    assert looks_left(scene, seen, BEGINS, jnp.float32(0)) == 1.0


def test_looks_that_count_less_are_those_before_the_frame():
    scene, seen = learned_scene(), detections(np.zeros((3, 2)), 5.0 * np.eye(3))
    nobody, frame, left = jnp.zeros(3, bool), jnp.int32(60), 0.25
    after = learn_scatter(scene, seen, seen.look * 0, nobody, FULL, frame, left=left)
    whole = learn_scatter(scene, seen, seen.look * 0, nobody, FULL, frame)
    assert after.num_looks == pytest.approx(left * scene.num_looks + 3)
    fades = after.looks_fade[0] / whole.looks_fade[0]
    assert fades == pytest.approx(left)
    np.testing.assert_allclose(after.mean, (45 * scene.mean + 5.0) / 48.0, rtol=1e-5)


def test_cosines_that_count_less_keep_their_means():
    scene = dataclasses.replace(
        empty_state().scene,
        cosine_weight=jnp.array([60.0, 10.0]),
        cosine_sum=jnp.array([6.0, 5.0]),
        cosine_squares=jnp.array([3.0, 4.0]),
    )
    faded = fade_cosines(scene, jnp.float32(1))
    found = np.stack([faded.cosine_weight, faded.cosine_sum, faded.cosine_squares])
    expected = [[10.0, 10.0], [1.0, 5.0], [0.5, 4.0]]
    np.testing.assert_allclose(found, expected, rtol=1e-6)  # in 32 bits


def visit(rng, looks: np.ndarray):
    """Things that stay where they are for some frames."""
    places = [[1.0 + k, 2.0] for k in range(NUM)]
    return [
        detections(places, looks + rng.normal(scale=0.03, size=looks.shape)) for _ in range(VISIT)
    ]


@pytest.mark.parametrize("strength", [4, 8])
def test_what_another_scene_has_in_common_makes_nobody_alike(strength):
    """Four in one light, then over cuts four and four others in another light."""
    rng = np.random.default_rng(0)
    light = strength * rng.normal(size=(2, DIM))
    own = 0.3 * rng.normal(size=(3 * NUM, DIM))
    looks = own + light[[0] * NUM + [1] * 2 * NUM]
    sets = np.arange(3 * NUM).reshape(3, NUM)
    seen = [one for things in sets for one in visit(rng, looks[things])]
    things = np.repeat(sets, VISIT, axis=0)
    sightings = jax.tree.map(lambda *leaves: np.stack(leaves), *seen)
    unknown = jax.tree.map(lambda leaf: np.stack([leaf] * len(things)), motion(score=0.0))
    static = Static(num_detections=NUM, num_objects=24, feature_dim=DIM)
    _, verdicts, _, _ = follow(Walk(sightings, unknown, things), static=static)
    last = verdicts.answer_id[VISIT - 1 :: VISIT]
    assert len(np.unique(last)) == 3 * NUM
