from __future__ import annotations

import numpy as np
import pytest

from remind_jax.errors import SourceError
from remind_jax.sources.layouts import Choice, locate, open_maps_at

from . import making

NAMES = ["a.jpg", "b.jpg"]


def make_video(root):
    making.write_video(root / "a.mp4", 3)
    return root / "a.mp4", "video", 3, False


def make_folder(root):
    making.write_images(root, NAMES)
    return root, "images", 2, False


def make_wrapped_folder(root):
    making.write_images(root / "inside", NAMES)
    return root, "images", 2, False


def make_one_image(root):
    making.write_images(root, NAMES)
    return root / "b.jpg", "images", 1, False


def make_features(root):
    np.save(root / "f.npy", np.zeros((4, 2, 3, 5), np.float32))
    return root / "f.npy", "features", 4, False


def make_davis_root(root):
    making.write_davis(root, metadata=making.LABELS)
    return root, "images", 3, True


def make_davis_sequence(root):
    making.write_davis(root, metadata=making.LABELS)
    return root / "JPEGImages" / "room", "images", 3, True


def make_scene(root):
    making.write_images(root / "iphone" / "rgb", ["frame_0.jpg"])
    (root / "obj_ids").mkdir()
    (root / "obj_ids" / "frame_0.png").write_bytes(making.gray_png(making.instance_map()))
    return root, "images", 1, True


@pytest.mark.parametrize(
    "make",
    [
        make_video,
        make_folder,
        make_wrapped_folder,
        make_one_image,
        make_features,
        make_davis_root,
        make_davis_sequence,
        make_scene,
    ],
)
def test_what_a_path_holds_is_recognized(tmp_path, make):
    path, kind, num, has_masks = make(tmp_path)
    reader, open_masks = locate(path, Choice())
    assert (reader.kind, reader.num_entries) == (kind, num)
    assert (open_masks is not None) == has_masks
    if open_masks is not None:
        open_masks()


def test_masks_of_another_folder_are_found_by_the_name_of_the_sequence(tmp_path):
    making.write_davis(tmp_path / "data", metadata=making.LABELS)
    reader, _ = locate(tmp_path / "data", Choice())
    for place in ("data", "data/Annotations", "data/Annotations/room"):
        maps = open_maps_at(tmp_path / place, reader, Choice())
        assert len(maps.detections_of(next(reader.entries(list.append)), making.SIZE)) == 2


@pytest.mark.parametrize(
    ("files", "why"),
    [
        (["a.txt"], "holds no images .* recognized are a folder of images"),
        (["x/a.jpg", "y/a.jpg"], "its folders x, y do: give one of them"),
    ],
)
def test_a_folder_without_one_sequence_says_what_to_do(tmp_path, files, why):
    for name in files:
        path = tmp_path / name
        path.parent.mkdir(exist_ok=True)
        path.write_bytes(making.jpg(0))
    with pytest.raises(SourceError, match=why):
        locate(tmp_path, Choice())


def test_masks_are_no_frames_and_pictures_are_no_masks(tmp_path):
    (tmp_path / "d.json").write_text("[]")
    with pytest.raises(SourceError, match="give it as masks"):
        locate(tmp_path / "d.json", Choice())
    making.write_images(tmp_path / "v", NAMES)
    reader, _ = locate(tmp_path / "v", Choice())
    with pytest.raises(SourceError, match="holds no instance maps"):
        open_maps_at(tmp_path / "v", reader, Choice())
