"""Scenes are found by layout, wherever the user keeps them."""

import pytest

from remind_jax.benchmark.scenes import find_scenes, select_scenes
from remind_jax.errors import SourceError
from tests.sources import making


def write_picture(path):
    making.write_image(path, making.picture(0))


def test_a_folder_of_davis_folders(dataset):
    scenes = find_scenes(dataset)
    assert [scene.name for scene in scenes] == ["alike-1", "light-1"]
    assert all(scene.layout == "davis" and scene.has_masks for scene in scenes)
    assert [len(list(scene.open())) for scene in scenes] == [8, 8]
    (only,) = find_scenes(dataset / "light-1")
    assert only.name == "light-1"


def test_one_davis_folder_with_several_sequences(tmp_path):
    for name in ("bear", "camel"):
        write_picture(tmp_path / "JPEGImages" / "480p" / name / "00000.jpg")
    write_picture(tmp_path / "Annotations" / "480p" / "bear" / "00000.png")
    scenes = find_scenes(tmp_path)
    assert [(scene.name, scene.has_masks) for scene in scenes] == [("bear", True), ("camel", False)]
    assert len(list(scenes[1].open(masks=False))) == 1
    before = [scene.digest() for scene in scenes]
    (tmp_path / "Annotations" / "480p" / "bear" / "00000.png").write_bytes(b"corrected")
    same = [scene.digest() == old for scene, old in zip(scenes, before, strict=True)]
    assert same == [False, True]


def test_scannetpp_with_annotations_beside_the_images(tmp_path):
    for scene in ("1a", "2b"):
        write_picture(tmp_path / "data" / scene / "dslr" / "resized_images" / "DSC0.JPG")
    write_picture(tmp_path / "annotations" / "2b" / "annotations" / "raw" / "frame_000000.png")
    scenes = find_scenes(tmp_path)
    assert [(s.name, s.layout, s.has_masks) for s in scenes] == [
        ("1a", "scannetpp", False),
        ("2b", "scannetpp", True),
    ]
    before = [scene.digest() for scene in scenes]
    folder = tmp_path / "annotations" / "2b" / "annotations"
    (folder / "raw" / "frame_000000.png").write_bytes(b"corrected")
    same = [scene.digest() == old for scene, old in zip(scenes, before, strict=True)]
    assert same == [True, False]


def test_scenes_by_name(dataset):
    scenes = find_scenes(dataset)
    assert select_scenes(scenes, ()) == scenes
    assert [s.name for s in select_scenes(scenes, ("light-1",))] == ["light-1"]
    with pytest.raises(SourceError, match=r"no scene 'lihgt-1'.*'light-1'"):
        select_scenes(scenes, ("lihgt-1",))


def test_nothing_to_find_is_told(tmp_path):
    with pytest.raises(SourceError, match="holds no scenes"):
        find_scenes(tmp_path)
    with pytest.raises(SourceError, match="is no folder"):
        find_scenes(tmp_path / "absent")
