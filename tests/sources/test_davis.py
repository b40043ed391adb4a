import json

import numpy as np
import pytest

from remind_jax.errors import SourceError
from remind_jax.sources import open_source
from tests.sources import making


def labels_of(source):
    return [f.detections.labels for f in source]


@pytest.mark.parametrize("place", ["", "JPEGImages", "JPEGImages/room"])
def test_root_and_sequence(tmp_path, place):
    making.write_davis(tmp_path, metadata=making.LABELS)
    source = open_source(tmp_path / place)
    frames = list(source)
    assert source.name == "room"
    assert [f.name for f in frames] == ["00000.jpg", "00001.jpg", "00002.jpg"]
    for frame in frames:
        detections = frame.detections
        assert detections.labels == ("cup", "desk_lamp")
        assert detections.instance_ids.tolist() == [1, 2]
        assert detections.masks.dtype == bool
        for mask, instance_id in zip(detections.masks, (1, 2), strict=True):
            np.testing.assert_array_equal(mask, making.instance_map() == instance_id)


def test_the_folder_above_is_a_sequence_as_well(tmp_path, monkeypatch):
    making.write_davis(tmp_path)
    (tmp_path / "JPEGImages/room/sub").mkdir()
    monkeypatch.chdir(tmp_path / "JPEGImages/room/sub")
    source = open_source("..")
    assert source.name == "room"
    assert [len(frame.detections) for frame in source] == [2] * 3


def test_masks_may_be_missing_or_ignored(tmp_path):
    making.write_images(tmp_path / "a" / "JPEGImages" / "room", ["0.jpg"])
    (frame,) = open_source(tmp_path / "a")
    assert frame.detections is None
    making.write_davis(tmp_path / "b")
    assert [f.detections for f in open_source(tmp_path / "b", masks="none")] == [None] * 3


def test_other_metadata_can_be_named(tmp_path):
    making.write_davis(tmp_path, metadata=making.LABELS)
    (tmp_path / "one.json").write_text(json.dumps({"id_to_class": {"1": "a", "2": "b"}}))
    source = open_source(tmp_path, metadata=tmp_path / "one.json")
    assert labels_of(source) == [("a", "b")] * 3
    (tmp_path / "one.json").write_text("{}")
    with pytest.raises(SourceError, match="maps no instance ids"):
        open_source(tmp_path, metadata=tmp_path / "one.json")


@pytest.mark.parametrize(
    "name", ["metaroom.json", "metaROOM.json", "Annotations/room/metadata.json"]
)
def test_places_of_metadata(tmp_path, name):
    making.write_davis(tmp_path)
    (tmp_path / name).write_text(json.dumps(making.LABELS))
    assert labels_of(open_source(tmp_path))[0] == ("cup", "desk_lamp")


def test_ids_without_class_are_named_all_at_once_with_the_file(tmp_path):
    making.write_davis(tmp_path, metadata={"id_to_label": {"1": "cup_1"}})
    making.write_map(tmp_path / "Annotations/room/00001.png", (1, 2, 9))
    with pytest.raises(SourceError, match=r"instances 2, 9 in .*add them to '.*metadata\.json'"):
        open_source(tmp_path)
    assert labels_of(open_source(tmp_path, unlabelled="skip")) == [("cup",)] * 3


def test_id_without_class_in_a_frame_not_looked_at_before(tmp_path):
    making.write_davis(tmp_path, num=9, metadata=making.LABELS)
    making.write_map(tmp_path / "Annotations/room/00006.png", (1, 2, 9))
    frames = iter(open_source(tmp_path))
    assert [next(frames).index for _ in range(6)] == list(range(6))
    with pytest.raises(SourceError, match="instances 9 in"):
        next(frames)


def test_missing_annotation_is_a_frame_without_detections(tmp_path):
    making.write_davis(tmp_path, metadata=making.LABELS)
    (tmp_path / "Annotations/room/00001.png").unlink()
    source = open_source(tmp_path)
    assert labels_of(source) == [("cup", "desk_lamp"), (), ("cup", "desk_lamp")]
    assert source.notes == [
        "1 of 3 frames of 'room' have no annotation; those that are read count as frames "
        "without detections"
    ]


def test_damaged_annotation_skips_its_frame(tmp_path):
    making.write_davis(tmp_path, num=9)
    (tmp_path / "Annotations/room/00001.png").write_bytes(b"\x89PNG damaged")
    source = open_source(tmp_path)
    assert [f.source_index for f in source] == [0, 2, 3, 4, 5, 6, 7, 8]
    assert source.skipped[0].name == "00001.jpg"
    assert "00001.png" in source.skipped[0].reason


def test_several_sequences_need_a_choice(tmp_path):
    making.write_davis(tmp_path, "bear")
    making.write_davis(tmp_path, "camel", num=2)
    with pytest.raises(SourceError, match=r"holds 2 sequences.*--sequence"):
        open_source(tmp_path)
    with pytest.raises(SourceError, match="did you mean 'camel'"):
        open_source(tmp_path, sequence="camell")
    assert len(list(open_source(tmp_path, sequence="camel"))) == 2
    assert open_source(tmp_path / "JPEGImages" / "bear").name == "bear"

    making.write_davis(tmp_path / "sizes", "480p/bear")  # a folder of a resolution between
    source = open_source(tmp_path / "sizes", sequence="bear")
    assert source.name == "bear"
    assert labels_of(source) == [("object", "object")] * 3


def test_listed_frames_are_the_frames_and_number_the_masks(tmp_path):
    making.write_images(tmp_path / "JPEGImages/room", ["c7.jpg", "a9.jpg", "x.jpg"])
    for number in (0, 1):
        making.write_map(tmp_path / f"Annotations/room/frame_{number:06d}.png", (5 + number,))
    listed = {"frame_names": ["c7.jpg", "a9.jpg"], "id_to_label": {"5": "a_1", "6": "b_1"}}
    (tmp_path / "metadata.json").write_text(json.dumps(listed))
    frames = list(open_source(tmp_path))
    assert [f.name for f in frames] == ["c7.jpg", "a9.jpg"]
    assert labels_of(frames) == [("a",), ("b",)]


def test_listed_frames_with_masks_of_their_name(tmp_path):
    making.write_davis(tmp_path, num=4, metadata={"frame_names": ["00002.jpg", "00001.jpg"]})
    making.write_map(tmp_path / "Annotations/room/00002.png", (8,))
    frames = list(open_source(tmp_path))
    assert [f.name for f in frames] == ["00002.jpg", "00001.jpg"]
    assert [f.detections.instance_ids.tolist() for f in frames] == [[8], [1, 2]]


def test_listed_frame_that_is_missing(tmp_path):
    making.write_davis(tmp_path, metadata={"frame_names": ["00000.jpg", "gone.jpg"]})
    with pytest.raises(SourceError, match=r"1 of 2 frames .* the first is 'gone\.jpg'"):
        open_source(tmp_path)
