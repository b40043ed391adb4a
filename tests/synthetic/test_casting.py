import dataclasses

import numpy as np
import pytest

from remind_jax.errors import ConfigError
from remind_jax.synthetic import SceneOptions, make_scene
from remind_jax.synthetic.floor_plan import ROOM_DEPTH_M
from remind_jax.synthetic.shapes import CLASSES
from remind_jax.synthetic.surfaces import turn
from tests.synthetic.conftest import SMALL


def test_objects_are_in_their_rooms():
    scene = make_scene(dataclasses.replace(SMALL, num_rooms=3, objects_per_room=12))
    for item in scene.objects:
        placement = item.placements[0]
        room = scene.rooms[placement.room]
        x, y, z = placement.position_m
        assert room.x_m[0] < x < room.x_m[1]
        assert 0 <= y <= ROOM_DEPTH_M
        assert 0 <= z < room.height_m


def test_changes_happen_while_the_camera_is_away():
    options = SceneOptions(objects_per_room=10, moved=0.3, removed=0.2, swapped=0.2, added=0.2)
    scene, before = make_scene(options), make_scene(SceneOptions(objects_per_room=10))
    (start, end), *_ = scene.path.away
    first = [item for item in scene.objects if item.placements[0].room == 0]
    ended = [item.placements[0].end_frame for item in first if item.placements[0].end_frame]
    assert ended
    assert all(start <= frame < end for frame in ended)
    moved = [item for item in first if len(item.placements) == 2]
    removed = [item for item in first if item.placement_at(options.frames - 1) is None]
    added = [item for item in first if item.placements[0].start_frame > 0]
    assert (len(moved), len(removed), len(added)) == (3 + 2, 2, 2)
    # What changes later does not touch the first visit.
    for item, twin in zip(scene.objects, before.objects, strict=False):
        assert item.placements[0].position_m == twin.placements[0].position_m


def test_a_full_room_is_refused_with_a_remedy():
    with pytest.raises(ConfigError, match="give fewer objects_per_room"):
        make_scene(SceneOptions(objects_per_room=200, classes=("chair",)))


def test_too_many_lookalikes_are_refused():
    with pytest.raises(ConfigError, match="look-alikes of room 0"):
        make_scene(dataclasses.replace(SMALL, objects_per_room=3))


def overlap_area(one, other):
    """Shared footprint of two objects, by sampling one of them."""
    (first, place), (second, other_place) = one, other
    half = np.array(CLASSES[first.label].size_m[:2]) * first.scale / 2
    grid = np.stack(np.meshgrid(*np.linspace(-half, half, 9).T), -1).reshape(-1, 2)
    points = turn(np.pad(grid, ((0, 0), (0, 1))), place.yaw_rad)[:, :2] + place.position_m[:2]
    local = np.pad(points - other_place.position_m[:2], ((0, 0), (0, 1)))
    local = np.abs(turn(local, -other_place.yaw_rad)[:, :2])
    return (local < np.array(CLASSES[second.label].size_m[:2]) * second.scale / 2).all(1).mean()


@pytest.mark.parametrize("seed", range(4))
def test_standing_objects_do_not_overlap(seed):
    scene = make_scene(SceneOptions(seed=seed, num_rooms=1, objects_per_room=20))
    standing = [
        (item, item.placements[0])
        for item in scene.objects
        if CLASSES[item.label].place == "surface"
    ]
    pairs = [
        (one, other)
        for index, one in enumerate(standing)
        for other in standing[:index]
        if abs(one[1].position_m[2] - other[1].position_m[2]) < 0.05
    ]
    assert pairs
    assert all(overlap_area(one, other) == 0 for one, other in pairs)
