import zipfile
from pathlib import Path

import cv2
import numpy as np
import pytest

from remind_jax.errors import SourceError
from remind_jax.formats.instance_maps import find_mots_png, read_mots_png
from remind_jax.masks.run_length import decode_mask
from remind_jax.metrics.opening import open_scenes


def write(folder, pictures, labels="mug\nbowl\n"):
    inner = folder / "instances"
    inner.mkdir(parents=True)
    for index, picture in enumerate(pictures):
        cv2.imwrite(str(inner / f"{index:06d}.png"), np.asarray(picture))
    if labels is not None:
        (inner / "labels.txt").write_text(labels)
    return folder


def test_class_and_instance_are_told_apart(tmp_path):
    first = np.array([[0, 1001, 1001], [2001, 10000, 1002]], np.uint16)
    rows = read_mots_png(write(tmp_path / "scene", [first, np.zeros((2, 3), np.uint16)]))
    assert rows.num_frames == 2
    assert sorted(rows.track_id) == [1001, 1002, 2001]
    assert [rows.class_names[number] for number in rows.class_id] == ["mug", "mug", "bowl"]
    assert rows.rles is not None
    assert decode_mask(rows.rles[0]).tolist() == [[0, 1, 1], [0, 0, 0]]
    assert rows.ignored_frame.tolist() == [0]


def test_classes_without_name_are_called_by_number(tmp_path):
    picture = np.array([[3007, 0]], np.uint16)
    scene = write(tmp_path / "scene", [picture], labels=None)
    assert read_mots_png(scene).class_names == ("class 3",)
    assert find_mots_png(scene) is None
    assert find_mots_png(scene, needs_labels=False) == "instances"


def test_what_cannot_be_is_refused(tmp_path):
    with pytest.raises(SourceError, match="no pictures in a folder 'instances'"):
        read_mots_png(tmp_path)
    sizes = [np.zeros((2, 3), np.uint16), np.zeros((3, 3), np.uint16)]
    with pytest.raises(SourceError, match=r"000001\.png has 3x3 pixels"):
        read_mots_png(write(tmp_path / "sizes", sizes))
    damaged = write(tmp_path / "damaged", sizes[:1])
    (damaged / "instances" / "000000.png").write_bytes(b"\x89PNG\r\n\x1a\n")
    with pytest.raises(SourceError, match=r"instances/000000\.png"):
        read_mots_png(damaged)


def test_a_zip_is_known_by_what_it_holds(tmp_path):
    scene = write(tmp_path / "scene", [np.array([[3007, 0]], np.uint16)], labels=None)
    path = tmp_path / "scene.zip"
    with zipfile.ZipFile(path, "w") as archive:
        archive.write(scene / "instances" / "000000.png", "instances/000000.png")
    assert open_scenes(path).format == "mots-png"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("notes.txt", "hello")
    with pytest.raises(SourceError, match=r"is a zip that holds neither 'annotations.xml' of CVAT"):
        open_scenes(path)
    data = path.read_bytes()
    path.write_bytes(data.replace(b"PK\x01\x02", b"PK\xff\xff"))
    with pytest.raises(SourceError, match=r"scene\.zip"):
        open_scenes(path)


def test_a_folder_that_may_not_be_read_is_told(tmp_path, monkeypatch):
    def refuse(self):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(Path, "iterdir", refuse)
    with pytest.raises(SourceError, match="Permission denied"):
        open_scenes(tmp_path)
