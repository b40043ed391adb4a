import itertools

import numpy as np
import pytest

from remind_jax.synthetic import SceneOptions, make_scene


def test_the_demo_camera_turns_slowly():
    poses = make_scene(SceneOptions()).path.poses
    steps = np.abs(np.diff(np.degrees([pose.yaw_rad for pose in poses])))
    assert 1.0 < steps.mean() < 3.0
    assert steps.max() < 5.0


@pytest.mark.parametrize("num_rooms", [1, 2, 4])
def test_the_camera_stays_within_rooms_and_leaves_the_first_one(num_rooms):
    scene = make_scene(SceneOptions(num_rooms=num_rooms))
    inside = np.zeros((len(scene.rooms), len(scene.path.poses)), bool)
    for row, room in enumerate(scene.rooms):
        for column, pose in enumerate(scene.path.poses):
            x, y, _ = pose.position_m
            inside[row, column] = room.x_m[0] <= x <= room.x_m[1] and room.y_m[0] < y < room.y_m[1]
    assert inside.any(0).all()
    (start, end), *_ = scene.path.away
    assert inside[0, : start - 3].all()
    assert not inside[0, start + 3 : end - 3].any()
    assert inside[0, end + 3 :].all()


def test_lamps_go_down_before_the_return():
    scene = make_scene(SceneOptions(light_drop=0.1))
    (start, end), *_ = scene.path.away
    levels = [scene.light.lamp_level(frame) for frame in range(len(scene.path.poses))]
    assert levels[start] == 1.0
    assert levels[end] == pytest.approx(0.1)
    assert all(a >= b for a, b in itertools.pairwise(levels))
