import dataclasses

import numpy as np
import pytest

from remind_jax.synthetic import make_scene, render, render_sequence
from remind_jax.synthetic.raster import NO_FACE, Camera, see_faces
from remind_jax.synthetic.rendering import _build_world
from tests.synthetic.conftest import SMALL, TINY


def visible_frames(sequence):
    seen = {}
    for frame in sequence.frames:
        for instance in frame.detections.instance_ids.tolist():
            seen.setdefault(instance, []).append(frame.index)
    return seen


def test_same_options_give_the_same_bytes(tiny):
    again = render_sequence(TINY)
    assert again.scene == tiny.scene
    for one, other in zip(tiny.frames, again.frames, strict=True):
        np.testing.assert_array_equal(one.image, other.image)
        np.testing.assert_array_equal(one.detections.masks, other.detections.masks)


def test_masks_are_disjoint_and_large_enough(small):
    for frame in small.frames:
        masks = np.asarray(frame.detections.masks)
        assert masks.sum(0, dtype=int).max(initial=0) <= 1
        assert (masks.sum((1, 2)) >= SMALL.min_mask_px).all()


def test_ids_are_stable_and_of_one_class(small):
    label_of = {item.instance_id: item.label for item in small.scene.objects}
    assert sorted(label_of) == list(range(1, len(label_of) + 1))
    num_seen = 0
    for frame in small.frames:
        ids = frame.detections.instance_ids.tolist()
        assert len(set(ids)) == len(ids)
        assert [label_of[i] for i in ids] == list(frame.detections.labels)
        num_seen += len(ids)
    assert num_seen > 2 * SMALL.frames


def test_objects_of_the_first_room_are_absent_as_long_as_asked(small):
    (start, end), *_ = small.scene.path.away
    assert end - start == SMALL.absence_frames
    rooms = {item.instance_id: item.placements[0].room for item in small.scene.objects}
    back = {
        instance: frames
        for instance, frames in visible_frames(small).items()
        if rooms[instance] == 0 and frames[0] < start and frames[-1] >= end
    }
    assert len(back) >= 4
    absences = [max(np.diff(frames)) - 1 for frames in back.values()]
    # The door lets a glance into the room just before and after, so not quite all of them.
    assert np.mean(np.array(absences) >= SMALL.absence_frames) >= 0.6


def test_every_pixel_inside_a_room_shows_a_face():
    scene = make_scene(TINY)
    world = _build_world(scene, 0)
    for pose in scene.path.poses[:3]:
        camera = Camera.at(pose, scene.path.horizontal_fov_rad, 160, 120)
        seen, _ = see_faces(world.mesh, camera)
        assert (seen != NO_FACE).all()


@pytest.mark.heavy
@pytest.mark.parametrize(
    "changes",
    [
        pytest.param(
            {"moved": 0.4, "removed": 0.2, "swapped": 0.4, "added": 0.4}, marks=pytest.mark.slow
        ),
        {"roll_deg": 10.0, "zoom": 1.5, "jumps": 2},
        {"dropped_frames": 0.5},
        {"returns": 2, "frames": 12},
        pytest.param({"num_rooms": 3}, marks=pytest.mark.slow),
    ],
    ids=["changes", "camera", "drops", "returns", "rooms"],
)
def test_harder_options_render(changes):
    options = dataclasses.replace(TINY, **changes)
    frames = list(render(make_scene(options)))
    assert len(frames) == options.frames
    sources = [frame.source_index for frame in frames]
    assert sources == sorted(set(sources))
    assert sum(len(frame.detections) for frame in frames) > 0
