import dataclasses
import json

import cv2
import numpy as np
import pytest

from remind_jax.errors import OutputError
from remind_jax.sources import open_source
from remind_jax.synthetic import record_davis, write_davis
from tests.sources.making import assert_same_detections


def test_davis_layout_holds_the_sequence(tiny, tmp_path):
    root = write_davis(tiny, tmp_path / "here")
    assert root == tmp_path / "here"
    assert sorted(path.name for path in root.iterdir()) == [
        "Annotations",
        "JPEGImages",
        "metadata.json",
    ]
    for frame in tiny.frames:
        path = root / "Annotations" / "tiny" / f"{frame.name}.png"
        instances = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
        assert instances.dtype == np.uint8
        assert instances.ndim == 2
        ids = frame.detections.instance_ids.tolist()
        assert sorted(set(instances.ravel().tolist()) - {0}) == ids
        for mask, instance in zip(frame.detections.masks, ids, strict=True):
            np.testing.assert_array_equal(instances == instance, mask)
        bgr = cv2.imread(str(root / "JPEGImages" / "tiny" / f"{frame.name}.jpg"))
        # JPEG at quality 92 is off by a grey level or two on average.
        assert np.abs(bgr[..., ::-1].astype(float) - frame.image).mean() < 4


def test_davis_metadata_names_ids(tiny, tmp_path):
    root = write_davis(tiny, tmp_path)
    data = json.loads((root / "metadata.json").read_text())
    labels = {item.instance_id: item.label for item in tiny.scene.objects}
    seen = {i for frame in tiny.frames for i in frame.detections.instance_ids.tolist()}
    assert {int(key) for key in data["id_to_class"]} == seen
    assert all(labels[int(key)] == name for key, name in data["id_to_class"].items())
    assert len(set(data["id_to_label"].values())) == len(seen)
    assert (data["frames"], data["width"], data["height"]) == (6, 160, 120)


def test_a_scene_is_rendered_while_writing(tiny, tmp_path):
    one, other = write_davis(tiny, tmp_path / "a"), write_davis(tiny.scene, tmp_path / "b")
    for path in sorted(one.rglob("*.*")):
        assert path.read_bytes() == (other / path.relative_to(one)).read_bytes()


def test_recorded_frames_are_those_that_are_read_again(tiny, tmp_path):
    recorded = list(record_davis(tiny.scene, tmp_path))
    read = list(open_source(tmp_path))
    assert len(recorded) == len(read) == len(tiny.frames)
    for one, other in zip(recorded, read, strict=True):
        assert (one.time_s, one.is_timed) == (other.time_s, other.is_timed)
        np.testing.assert_array_equal(one.image, other.image)
        assert_same_detections(one.detections, other.detections)


def test_ids_beyond_eight_bits_are_refused(tiny, tmp_path):
    item = dataclasses.replace(tiny.scene.objects[0], instance_id=256)
    scene = dataclasses.replace(tiny.scene, objects=(item,))
    with pytest.raises(OutputError, match="256 does not fit"):
        write_davis(scene, tmp_path)


def test_the_classes_of_another_scene_are_not_replaced(tiny, tmp_path):
    write_davis(tiny, tmp_path)
    write_davis(tiny, tmp_path)  # again
    other = dataclasses.replace(tiny.scene, name="other")
    with pytest.raises(OutputError, match=r"metadata\.json of scene 'tiny'; give 'other' a folder"):
        write_davis(other, tmp_path)
    (tmp_path / "metadata.json").rename(tmp_path / "Annotations" / "tiny" / "metadata.json")
    write_davis(other, tmp_path)
    for name in ("tiny", "other"):
        assert len(list(open_source(tmp_path, sequence=name))) == len(tiny.frames)
