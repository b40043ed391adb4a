"""Who moves of its own, and that it is expected elsewhere."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from remind_jax.numerics.absent import NO_SLOT
from remind_jax.plus import learning, own_movement, scene_map
from remind_jax.plus.own_movement import (
    HALF_SPEED,
    LEAVING,
    STAYING,
    STAYING_PRIOR,
    fade_background,
    first_speed,
    mobility,
    speed_of,
    staying,
    staying_of_class,
)
from remind_jax.plus.slots import NO_ROW
from remind_jax.plus.state import NO_RELATION
from tests.plus.frames import (
    TICK,
    T,
    detections,
    empty_state,
    go_on,
    motion,
    objects_of,
    tracklets_of,
)
from tests.plus.test_evidence import candidates

ROOM = 9
expect_step = jax.jit(own_movement.expect_step)
learn_speeds, learn_relations = (
    jax.jit(own_movement.learn_speeds),
    jax.jit(learning.learn_relations),
)
move_map = jax.jit(scene_map.move_map)
START = np.array([[1.0, 1.0], [3.0, 1.0], [5.0, 1.0]])
WALK = np.array([0.3, 0.0])
STILL = motion((0.0, 0.0), 1.0)


def follow(
    steps: np.ndarray,
    frames: int = 12,
    touches: tuple[bool, ...] = (False,) * 3,
    shift: float = 0.0,
    doubt: float = 1.0,
):
    """Tracklets of three things that make these steps per frame.

    `shift`: how far the image moves per frame, `doubt`: how little that is believed.
    """
    tracklets = tracklets_of(detections(START), 0, ROOM)
    for frame in range(1, frames):
        seen = detections(START + frame * steps, touches=jnp.array(touches))
        carried = dataclasses.replace(
            tracklets,
            center=tracklets.center + expect_step(tracklets, T.mobility),
        )
        tracklets, _, _ = go_on(carried, seen, [0, 1, 2], frame, shift=shift, doubt=doubt)
    return tracklets


def test_what_moves_among_things_at_rest_is_found_out():
    tracklets = follow(np.array([WALK, 0 * WALK, 0 * WALK]))
    np.testing.assert_allclose(tracklets.drift[0], WALK, rtol=1e-4)
    assert speed_of(tracklets)[0] == pytest.approx(0.3 - own_movement.NOISE, rel=1e-3)
    assert speed_of(tracklets)[1:3].tolist() == [0, 0]
    expected = expect_step(tracklets, T.mobility)
    assert 0 < expected[0, 0] < 0.3
    assert not expected[1:3].any()


def test_what_most_share_is_the_camera():
    tracklets = follow(np.array([WALK, WALK, WALK]))
    assert not speed_of(tracklets).any()


def test_a_moving_camera_makes_things_at_rest_seem_to_move():
    """What is near moves more than the image does; that is no movement of its own."""
    parallax = np.array([[0.05, 0.0], [0.0, 0.0], [0.0, 0.0]])
    at_rest = follow(parallax, shift=0.0, doubt=0.0)
    panning = follow(parallax, shift=0.2, doubt=0.0)
    assert speed_of(at_rest)[0] > 0.03
    assert speed_of(panning).tolist()[:3] == [0, 0, 0]
    np.testing.assert_allclose(panning.image_shift[:3], 0.2, rtol=1e-5)


def test_the_border_of_the_frame_is_no_movement():
    tracklets = follow(np.array([WALK, 0 * WALK, 0 * WALK]), touches=(True, False, False))
    assert tracklets.num_moves[0] == 0
    assert not tracklets.drift[0].any()


def test_new_objects_are_as_fast_as_the_scene_where_little_is_known():
    scene = dataclasses.replace(empty_state().scene, speed=jnp.float32(0.2))
    known = follow(np.array([0 * WALK] * 3), frames=30)
    unknown = follow(np.array([0 * WALK] * 3), frames=1)
    assert first_speed(unknown, scene)[0] == pytest.approx(0.2)
    assert first_speed(known, scene)[0] < 0.05


def test_speeds_of_objects_and_scene_follow_those_in_view():
    here = jax.tree.map(lambda leaf: leaf[:3], follow(np.array([WALK, 0 * WALK, 0 * WALK])))
    objects, scene = objects_of(np.eye(3)), empty_state().scene
    row = jnp.array([0, 1, NO_ROW, NO_ROW])
    for _ in range(40):
        objects, scene = learn_speeds(objects, scene, here, here.alive, row)
    assert objects.speed[0] > 0.2
    assert objects.speed[1:].tolist() == [0, 0, 0]
    assert 0 < scene.speed < objects.speed[0]


def with_speed(speed: float):
    objects = objects_of(np.eye(3))
    return dataclasses.replace(objects, speed=jnp.zeros(4).at[0].set(speed))


def test_a_place_is_lost_as_fast_as_its_object_moves():
    grown = []
    for speed in (0.0, 0.3):
        objects, pairs = with_speed(speed), empty_state().pairs
        objects = dataclasses.replace(objects, last=jnp.zeros(4, jnp.int32))
        for frame in range(1, 30):
            objects, pairs = move_map(
                objects, pairs, STILL, jnp.array([3.2, 2.4]), jnp.int32(frame),
                jnp.float32(1), T.motion, T.mobility,
            )  # fmt: skip
        grown.append(jnp.diag(pairs.covariance))
    assert grown[1][0] > 20 * grown[0][0]
    np.testing.assert_array_equal(grown[0][1:], grown[1][1:])  # the others know nothing of it


def test_a_relation_is_forgotten_as_fast_as_its_objects_move():
    spreads = []
    for speed in (0.0, 0.3):
        objects, state = with_speed(speed), empty_state()
        seen = detections(START)
        row = jnp.array([0, 1, 2, NO_ROW])
        pairs = learn_relations(objects, state.pairs, row, seen, TICK, T.mobility)
        nobody = jnp.full(4, NO_ROW)
        for _ in range(20):
            pairs = learn_relations(objects, pairs, nobody, seen, TICK, T.mobility)
        spreads.append(pairs.spread)
    assert spreads[0][0, 1] < 0.5
    assert spreads[1][0, 1] > NO_RELATION
    assert spreads[0][1, 2] == spreads[1][1, 2] < 0.5


def test_looks_of_what_moves_may_decide_alone():
    def weigh(speed: float, cosine: float = 0.95):
        alike = jnp.full((3, 4), cosine)
        found = candidates(with_speed(speed), detections(START), cosine=alike)
        first = jnp.argmax(found.slot[0] == 0)
        return jax.tree.map(lambda kind: float(kind[0, first]), found.evidence)

    still, moving = weigh(0.0), weigh(0.3)
    assert still.mobile == 0
    assert weigh(0.0, 0.7).looks == pytest.approx(float(T.looks.best)), "it is not clear"
    assert moving.mobile > 0.9 * float(T.mobility.gain)
    assert moving.looks > still.looks + 1


def test_the_background_leaves_the_looks_of_what_moves():
    scene = dataclasses.replace(
        empty_state().scene, mean=jnp.array([0.1, 0.2, 0.3]), speed=jnp.float32(HALF_SPEED)
    )
    seen = detections(
        START,
        np.eye(3) * 5,
        is_background=np.array([False, True, True]),
        has_ring=np.array([True, False, True]),
    )
    at_rest = follow(np.zeros((3, 2)), frames=400)
    origin = jnp.array([0, 1, NO_SLOT])
    look = jax.jit(fade_background)(seen, origin, at_rest, scene, T.mobility).look
    # Nearly as before, at rest for long; of no background; of what begins, by the scene.
    np.testing.assert_allclose(look[0], seen.look[0], atol=0.05)
    np.testing.assert_allclose(look[1], [0.0, 0.2, 0.3], atol=1e-6)
    assert look[2, 0] == 0.0
    assert look[2, 2] == pytest.approx(0.3 + 0.5**LEAVING * (5.0 - 0.3), rel=1e-5)
    walking = follow(np.array([WALK, 0 * WALK, 0 * WALK]))
    faded = jax.jit(fade_background)(seen, origin, walking, scene, T.mobility).look
    np.testing.assert_allclose(faded[0], [5.0, 0.2, 0.3], atol=0.05)


def test_what_stands_among_others_of_its_class_that_move_may_go():
    objects = objects_of(
        np.ones((4, 3)), speed=jnp.array([0.0, 0.2, 0.2, 0.0]), class_id=jnp.array([0, 0, 0, 1])
    )
    stays = jax.jit(staying)(objects, T.mobility)
    moves = 2 * float(mobility(jnp.array([0.2]), T.mobility)[0]) / (3 + STAYING_PRIOR)
    assert stays[0] == pytest.approx((1 - moves) ** STAYING, rel=1e-5)
    assert stays[1] < 0.02 * stays[0]
    assert stays[3] == 1.0
    of_class = jax.jit(staying_of_class)(jnp.array([0, 1, 2]), objects, T.mobility)
    np.testing.assert_allclose(of_class, [stays[0], 1.0, 1.0], rtol=1e-6)


def test_nothing_moves_where_the_weight_is_zero():
    off = dataclasses.replace(T.mobility, weight=0.0)
    assert not mobility(jnp.array([0.0, 0.3, 5.0]), off).any()
    assert mobility(jnp.array([0.3]), T.mobility)[0] > 0.5


def test_an_unlinked_detection_begins_at_rest():
    tracklets = follow(np.array([WALK, 0 * WALK, 0 * WALK]))
    fresh, _, _ = go_on(tracklets, detections(START), [NO_SLOT] * 3, 12)
    assert not fresh.drift[:3].any()
    assert not fresh.num_moves[:3].any()
