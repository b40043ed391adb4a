"""Looks are compared along what does not vary within tracklets."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np

from remind_jax.plus import whitening
from remind_jax.plus.state import init
from remind_jax.plus.whitening import adjust_cosine, whiten
from remind_jax.static import Static
from tests.plus.frames import T, detections, empty_state, objects_of

learn_scatter = jax.jit(whitening.learn_scatter)
renew_whitening = jax.jit(whitening.renew_whitening)
FULL = jnp.ones(3)  # all teach in full
MANY = detections(np.zeros((3, 2)))
LIGHT = np.array([1.0, 0.0, 0.0])  # what varies within tracklets
KIND = np.array([0.0, 1.0, 0.0])  # what tells objects apart


def learned():
    """Statistics of three objects whose looks wander along `LIGHT`, without the last renewal."""
    rng = np.random.default_rng(0)
    state = empty_state()
    scene = state.scene
    for frame in map(jnp.int32, range(61)):
        wander = rng.normal(size=3)[:, None] * LIGHT
        looks = np.array([[-1.0], [0.0], [1.0]]) * KIND + wander
        seen = detections(np.zeros((3, 2)), looks)
        step = jnp.asarray(wander, jnp.float32)
        scene = learn_scatter(scene, seen, step, jnp.ones(3, bool), FULL, frame)
        if frame < 60:
            scene, _ = renew_whitening(scene, state.objects, seen, frame, T)
    return scene


def test_what_varies_within_tracklets_counts_less():
    state = empty_state()
    scene, _ = renew_whitening(learned(), state.objects, MANY, jnp.int32(60), T)
    base = whiten(scene, jnp.asarray(KIND, jnp.float32))
    by_light = whiten(scene, jnp.asarray(KIND + 0.5 * LIGHT, jnp.float32))
    by_kind = whiten(scene, jnp.asarray(0.5 * KIND + 0.5 * LIGHT, jnp.float32))
    plain = np.dot(KIND, KIND + 0.5 * LIGHT) / np.linalg.norm(KIND + 0.5 * LIGHT)
    assert base @ by_light > plain + 0.02
    assert base @ by_light > base @ by_kind
    np.testing.assert_allclose(jnp.linalg.norm(base), 1.0, rtol=1e-5)


def test_what_light_of_another_color_changes_counts_less_before_it_did():
    state = empty_state()

    def cosine(change: float) -> float:
        seen = dataclasses.replace(MANY, light_changes=jnp.float32([[0.0, 0.0, change]]))
        scene, _ = renew_whitening(learned(), state.objects, seen, jnp.int32(60), T)
        before, after = whiten(scene, jnp.float32([KIND, [0.0, 1.0, 0.5]]))
        return float(before @ after)

    assert cosine(0.0) + 0.05 < cosine(0.7) < cosine(2.0) - 0.01


def test_what_is_remembered_is_whitened_anew_when_it_is_due():
    objects = objects_of([KIND])
    scene, renewed = renew_whitening(learned(), objects, MANY, jnp.int32(60), T)
    np.testing.assert_allclose(renewed.white_bank[0, 0], whiten(scene, objects.bank[0, 0]))
    same, unchanged = renew_whitening(learned(), objects, MANY, jnp.int32(61), T)
    np.testing.assert_array_equal(unchanged.white_bank, objects.white_bank)
    np.testing.assert_array_equal(same.whitener, learned().whitener)


def test_looks_are_compared_about_the_mean_of_their_class_as_far_as_it_stays():
    """Three of one class with something in common, and one of another class."""
    kinds = KIND + 0.3 * np.array([[1, 0, 0], [-1, 0, 1], [0, 0, -1]])
    objects = objects_of([*kinds, LIGHT], class_id=jnp.array([2, 2, 2, 7]))
    scene = dataclasses.replace(learned(), white_mean=jnp.zeros(3), mean=jnp.zeros(3))
    scene, renewed = renew_whitening(scene, objects, MANY, jnp.int32(60), T)
    believed = 2 / (2 + whitening.CLASS_PRIOR)
    # Sums of another order.
    np.testing.assert_allclose(scene.class_offset[2], believed * KIND, atol=1e-6)
    np.testing.assert_array_equal(scene.class_offset[7], np.zeros(3))  # a single object
    expected = whiten(scene, jnp.asarray(kinds - believed * KIND, jnp.float32))
    np.testing.assert_allclose(renewed.white_bank[:3, 0], expected, atol=1e-6)
    moving = dataclasses.replace(objects, speed=jnp.full(len(objects.id), 1.0))
    scene, _ = renew_whitening(scene, moving, MANY, jnp.int32(63), T)
    assert np.linalg.norm(scene.class_offset[2]) < 0.1 * believed


def looks_about_one(rng, dim: int, cosine: float) -> np.ndarray:
    """A unit vector, and others of that cosine to it and to each other."""
    own = np.linalg.qr(rng.normal(size=(dim, 4)))[0].T
    common = np.sqrt(cosine) * own[0]
    return (common + np.sqrt(1 - cosine) * own[1:]).astype(np.float32)


def test_the_only_object_looks_like_itself_and_others_do_not():
    """About the mean of its own looks, it would look like nobody."""
    dim, rng = 64, np.random.default_rng(3)
    one, other, third = looks_about_one(rng, dim, whitening.UNLIKE_COSINE)
    state = init(Static(num_detections=1, num_objects=4, feature_dim=dim))
    scene = state.scene
    for frame in map(jnp.int32, range(20)):
        step = rng.normal(scale=0.01, size=(1, dim)).astype(np.float32)
        seen = detections(np.zeros((1, 2)), one + step)
        linked = jnp.array([frame > 0])
        scene = learn_scatter(scene, seen, jnp.asarray(step), linked, FULL[:1], frame)
        scene, _ = renew_whitening(scene, state.objects, seen, frame, T)

    def cosine(left: np.ndarray, right: np.ndarray) -> float:
        white = whiten(scene, jnp.stack([left, right]))
        return float(adjust_cosine(scene, white[0] @ white[1]))

    again = one + rng.normal(scale=0.02, size=dim).astype(np.float32)
    assert cosine(one, again) > 0.7
    # The scatter of twenty frames is not quite the same in all directions.
    np.testing.assert_allclose(cosine(one, other), 0.0, atol=0.1)
    np.testing.assert_allclose(cosine(other, third), 0.0, atol=0.1)


def test_the_mean_of_many_objects_counts_in_full():
    rng = np.random.default_rng(4)
    scene, _ = renew_whitening(learned(), objects_of(np.eye(3)), MANY, jnp.int32(60), T)
    assert 0.0 < scene.raised < 0.01
    np.testing.assert_allclose(scene.white_mean, scene.mean, rtol=0.05)
    crowd = detections(np.zeros((40, 2)), rng.normal(size=(40, 3)))
    crowded, _ = renew_whitening(learned(), objects_of(np.eye(3)), crowd, jnp.int32(60), T)
    assert crowded.raised < 1e-6
    np.testing.assert_allclose(
        adjust_cosine(crowded, jnp.array([-1.0, 0.3])), [-1.0, 0.3], atol=1e-6
    )


def test_scatters_are_the_sums_over_all_frames_however_late_they_are_summed():
    """Those of looks about the means of their classes."""
    state, rng = empty_state(), np.random.default_rng(1)
    offset = rng.normal(size=state.scene.class_offset.shape).astype(np.float32)
    scene, total, within = state.scene, np.zeros((3, 3)), np.zeros((3, 3))
    for frame in map(jnp.int32, range(13)):
        looks, step = rng.normal(size=(2, 3, 3)).astype(np.float32)
        seen = detections(np.zeros((3, 2)), looks, class_id=np.arange(3))
        linked = jnp.arange(3) < frame % 4
        scene = dataclasses.replace(scene, class_offset=jnp.asarray(offset))
        scene = learn_scatter(scene, seen, jnp.asarray(step), linked, FULL, frame)
        around, moved = looks - scene.mean - offset[:3], step[np.asarray(linked)]
        total = total * whitening.SCATTER_DECAY**3 + around.T @ around
        within = within * whitening.SCATTER_DECAY ** len(moved) + moved.T @ moved
        scene, _ = renew_whitening(scene, state.objects, seen, frame, T)
    np.testing.assert_allclose(scene.total, total, rtol=1e-4, atol=1e-4)
    np.testing.assert_allclose(scene.within, within, rtol=1e-4, atol=1e-4)


def test_empty_slots_teach_nothing():
    scene = empty_state().scene
    nan = jnp.full((3, 3), jnp.nan)
    nobody = jnp.zeros(3, bool)
    nothing = detections(np.zeros((3, 2)), nan, ring=nan, valid=nobody, has_ring=nobody)
    after = learn_scatter(scene, nothing, nan, nobody, FULL, jnp.int32(0))
    for field in dataclasses.fields(scene):
        np.testing.assert_array_equal(getattr(after, field.name), getattr(scene, field.name))


def test_the_mean_background_is_that_of_detections_that_have_one():
    rings = jnp.asarray([[1.0, 2, 3], [3.0, 2, 1], [9.0, 9, 9]])
    seen = detections(np.zeros((3, 2)), ring=rings, has_ring=jnp.array([True, True, False]))
    nobody, now = jnp.zeros(3, bool), jnp.int32(0)
    scene = learn_scatter(empty_state().scene, seen, rings, nobody, FULL, now)
    np.testing.assert_allclose(scene.ring_mean, [2.0, 2.0, 2.0], rtol=1e-6)
    assert scene.num_rings == 2
    assert scene.num_looks == 3


def test_what_rounding_alone_tells_from_the_mean_of_all_has_no_direction():
    state = empty_state()
    noise = np.random.default_rng(0).normal(scale=1e-7, size=(5, len(KIND)))
    scene = dataclasses.replace(state.scene, white_mean=jnp.asarray(KIND, jnp.float32))
    white = whiten(scene, jnp.asarray(KIND + noise, jnp.float32))
    np.testing.assert_array_equal(white, np.zeros_like(white))


def test_directions_that_no_look_spans_yet_are_not_those_of_rounding():
    """Few looks leave most directions open; a look that is new to the scene lies in these."""
    dim, num = 128, 3
    rng = np.random.default_rng(6)
    looks, new = rng.normal(size=(2, num, dim)).astype(np.float32)
    state = init(Static(num_detections=num, num_objects=4, feature_dim=dim))

    def cosines(rounding: float) -> np.ndarray:
        scene = state.scene
        for frame in map(jnp.int32, range(9)):
            shown = looks * (1 + rounding * rng.normal(size=looks.shape))
            seen = detections(np.zeros((num, 2)), shown)
            steps = jnp.asarray(shown - looks, jnp.float32)
            scene = learn_scatter(scene, seen, steps, jnp.ones(num, bool), FULL, frame)
            scene, _ = renew_whitening(scene, state.objects, seen, frame, T)
        return np.asarray(whiten(scene, new) @ whiten(scene, new).T)

    # 1e-6 is some ten units of rounding; were it to choose the directions, 2e-3 would come of it.
    np.testing.assert_allclose(cosines(1e-6), cosines(0.0), atol=2e-4)
