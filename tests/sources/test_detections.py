import types

import numpy as np
import pytest

from remind_jax.crops import Crops
from remind_jax.errors import SourceError
from remind_jax.frame import Detections, fill_boxes
from remind_jax.sources import detections_from
from tests.sources import making

SIZE = making.SIZE
MASKS = np.stack([making.instance_map() == i for i in (1, 2)])


def foreign(**parts):
    """Looks like `supervision.Detections`."""
    neutral = {"xyxy": np.zeros((2, 4)), "mask": None, "confidence": None, "class_id": None}
    return types.SimpleNamespace(**{**neutral, "data": {}, **parts})


def test_supervision_masks_and_names():
    given = foreign(
        mask=MASKS, confidence=np.array([0.5, 0.75]), data={"class_name": np.array(["a", "b"])}
    )
    found = detections_from(given, SIZE)
    np.testing.assert_array_equal(found.masks, MASKS)
    assert found.labels == ("a", "b")
    assert found.scores.tolist() == [0.5, 0.75]
    assert found.instance_ids.tolist() == [-1, -1]


def test_supervision_class_ids_are_named():
    given = foreign(mask=MASKS, class_id=np.array([3, 0]))
    assert detections_from(given, SIZE, {0: "cup", 3: "tv"}).labels == ("tv", "cup")
    assert detections_from(given, SIZE, ["cup", "b", "c", "tv"]).labels == ("tv", "cup")
    assert detections_from(given, SIZE).labels == ("3", "0")
    with pytest.raises(SourceError, match="class ids 3 have no name"):
        detections_from(given, SIZE, ["cup"])


def test_supervision_boxes_stand_in_for_masks():
    given = foreign(xyxy=np.array([[1.0, 2.0, 4.0, 6.0], [-5.0, -5.0, 500.0, 500.0]]))
    found = detections_from(given, SIZE)
    assert Crops.of(found.masks).areas.tolist() == [12, SIZE[0] * SIZE[1]]
    assert found.masks[0, 2:6, 1:4].all()


def test_real_supervision_objects():
    sv = pytest.importorskip("supervision")
    given = sv.Detections(xyxy=np.zeros((2, 4)), mask=MASKS, class_id=np.array([0, 1]))
    assert detections_from(given, SIZE, ["a", "b"]).labels == ("a", "b")
    assert len(detections_from(sv.Detections.empty(), SIZE)) == 0


def test_mapping():
    found = detections_from(
        {"masks": MASKS, "labels": ["a", "b"], "scores": [0.5, 1], "instance_ids": [4, 2]}, SIZE
    )
    assert found.labels == ("a", "b")
    assert found.instance_ids.tolist() == [4, 2]
    with pytest.raises(SourceError, match="unknown part 'mask'"):
        detections_from({"mask": MASKS}, SIZE)
    with pytest.raises(SourceError, match="neither 'masks' nor 'boxes'"):
        detections_from({"labels": []}, SIZE)


def test_masks():
    for given in (MASKS, MASKS.astype(np.uint8), MASKS * 255.0, list(MASKS)):
        np.testing.assert_array_equal(detections_from(given, SIZE).masks, MASKS)
    np.testing.assert_array_equal(detections_from(MASKS[1], SIZE).masks, MASKS[1:])


def test_instance_map():
    found = detections_from(making.instance_map(ids=(300, 7)), SIZE, {7: "a", 300: "b"})
    assert found.instance_ids.tolist() == [7, 300]
    assert found.labels == ("a", "b")
    np.testing.assert_array_equal(found.masks, MASKS[::-1])


def test_ours_and_nothing():
    ours = Detections.create(MASKS, ["a", "b"])
    assert detections_from(ours, SIZE) is ours
    for nothing in (None, np.zeros((0, 3, 4)), [], np.zeros(SIZE, np.uint8)):
        found = detections_from(nothing, SIZE)
        assert found.masks.shape == (0, *SIZE)


def test_masks_of_the_same_aspect_are_resized():
    big = np.stack([making.instance_map((64, 96)) == i for i in (1, 2)])
    for given in (big, Detections.create(big), making.instance_map((64, 96))):
        np.testing.assert_array_equal(detections_from(given, SIZE).masks, MASKS)


def test_box_the_wrong_way_round_is_empty():
    assert not np.asarray(fill_boxes(np.array([[9.0, 9.0, 3.0, 3.0]]), SIZE)).any()


def test_masks_and_boxes_in_another_form_are_refused():
    for given, words in (
        (np.ones((2, 48, 48), bool), "a mask is 48x48, its frame is 48x32"),
        (np.ones((48, 48), np.uint8), "a mask is 48x48, its frame is 48x32"),
        (np.array(True), r"masks have shape \(\)"),
        ({"boxes": np.array([[1, 1, 5, 5], [9, 9, 3, 3]])}, "box 1 is .*left, top"),
        ({"boxes": np.array([[0.1, 0.1, 0.5, 0.9]])}, "pixels"),
        (np.ones((2, 4)), r"numbers \[2, 4\]; boxes are given as \{'boxes'"),
    ):
        with pytest.raises(SourceError, match=words):
            detections_from(given, SIZE)
