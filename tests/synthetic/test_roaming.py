"""Objects that fly about: each on a way of its own, gone at times, back elsewhere."""

import numpy as np
import pytest

from remind_jax.synthetic import SceneOptions, make_scene, render

OPTIONS = {
    "seed": 3, "width": 160, "height": 120, "frames": 40, "num_rooms": 1, "objects_per_room": 8,
    "absence_frames": 0, "light_drop": 1.0, "min_mask_px": 20,
}  # fmt: skip


def test_a_share_of_the_first_room_roams_and_the_rest_stays():
    scene = make_scene(SceneOptions(**OPTIONS, roaming=0.5, camera="still"))
    still = make_scene(SceneOptions(**OPTIONS, camera="still"))
    roaming = [item for item in scene.objects if item.roams]
    assert len(roaming) == 4
    for item, twin in zip(scene.objects, still.objects, strict=True):
        assert item.look == twin.look
        assert item.roams or item.placements == twin.placements


def test_ways_have_no_jumps_within_a_visit_and_gaps_between():
    options = SceneOptions(**{**OPTIONS, "frames": 300}, roaming=1.0, camera="pan")
    absences = 0
    for item in make_scene(options).objects:
        last = None
        for place in item.placements:
            if last is not None and last.end_frame == place.start_frame:
                np.testing.assert_allclose(last.pose_at(last.end_frame)[0], place.position_m)
                assert last.pose_at(last.end_frame)[1] == pytest.approx(place.yaw_rad)
            elif last is not None:
                absences += 1
                assert item.placement_at(last.end_frame) is None
            last = place
    assert absences > 8


def test_the_camera_stands_and_the_objects_move_in_the_picture():
    options = SceneOptions(**OPTIONS, roaming=1.0, camera="still", shake=0.0)
    scene = make_scene(options)
    assert len({(pose.position_m, pose.yaw_rad) for pose in scene.path.poses}) == 1
    centers = {}
    for frame in render(scene):
        found = frame.detections
        for instance, mask in zip(found.instance_ids, found.masks, strict=True):
            rows, columns = np.nonzero(mask)
            centers.setdefault(int(instance), []).append((columns.mean(), rows.mean()))
    moved = [np.ptp(np.array(way), axis=0).max() for way in centers.values() if len(way) > 8]
    assert len(moved) >= 3
    assert min(moved) > 10
