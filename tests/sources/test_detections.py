"""Detections in every form that detectors publish."""

import types

import cv2
import numpy as np
import pytest

from remind_jax.crops import Crops
from remind_jax.errors import SourceError
from remind_jax.frame import Detections, fill_boxes
from remind_jax.sources import detections_from
from tests.sources import making
from tests.sources.published import sam_masks, ultralytics_results

SIZE = making.SIZE
MASKS = np.stack([making.instance_map() == i for i in (1, 2)])
BOXES = [[1.0, 2.0, 9.0, 12.0], [20.0, 4.0, 40.0, 30.0]]


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
    found = detections_from(given, SIZE, ["a", "b"])
    assert found.labels == ("a", "b")
    np.testing.assert_array_equal(found.masks, MASKS)
    assert len(detections_from(sv.Detections.empty(), SIZE)) == 0
    compact = sv.CompactMask.from_dense(MASKS, np.array(BOXES), image_shape=SIZE)
    given = sv.Detections(xyxy=np.array(BOXES), mask=compact)
    np.testing.assert_array_equal(detections_from(given, SIZE).masks, compact.to_dense())


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


def letterboxed(masks: np.ndarray, input_size: tuple[int, int], dtype=np.uint8) -> np.ndarray:
    """Masks as a network sees them, by the definition of its input."""
    planes = np.zeros((len(masks), *input_size), dtype)
    ratio = min(input_size[0] / masks.shape[1], input_size[1] / masks.shape[2])
    height, width = round(masks.shape[1] * ratio), round(masks.shape[2] * ratio)
    top = round((input_size[0] - height) / 2 - 0.1)
    left = round((input_size[1] - width) / 2 - 0.1)
    for plane, mask in zip(planes, masks, strict=True):
        scaled = cv2.resize(mask.astype(np.uint8), (width, height), interpolation=cv2.INTER_NEAREST)
        plane[top : top + height, left : left + width] = scaled
    return planes


@pytest.mark.parametrize("dtype", [np.uint8, np.float32, bool])
def test_planes_of_yolo_leave_the_letterbox(dtype):
    planes = letterboxed(MASKS, (4 * SIZE[1], 4 * SIZE[1]), dtype)
    answer = ultralytics_results(SIZE, BOXES, planes, classes=[1, 0])
    found = detections_from(answer, SIZE)
    np.testing.assert_array_equal(found.masks, MASKS)
    assert found.labels == ("tv", "cup")
    np.testing.assert_allclose(found.scores, [0.9, 0.5])


def test_boxes_of_a_yolo_that_segments_nothing():
    found = detections_from(ultralytics_results(SIZE, BOXES, classes=[0, 1]), SIZE)
    assert found.labels == ("cup", "tv")
    rows, columns = np.nonzero(np.asarray(found.masks)[1])
    assert (rows.min(), rows.max() + 1, columns.min(), columns.max() + 1) == (4, 30, 20, 40)


def test_one_answer_may_come_in_a_list_and_hold_nothing():
    answer = ultralytics_results(SIZE, BOXES)
    assert len(detections_from([answer], SIZE)) == 2
    with pytest.raises(SourceError, match="answered for 2 pictures; give the answer for one frame"):
        detections_from([answer, answer], SIZE)
    empty = ultralytics_results(SIZE, [])
    for nothing in (empty, [ultralytics_results(SIZE, [], np.zeros((0, 8, 8)))], []):
        assert len(detections_from(nothing, SIZE)) == 0
    empty.boxes = None
    with pytest.raises(SourceError, match="neither boxes nor masks"):
        detections_from(empty, SIZE)


def test_names_of_the_answer_go_before_names_of_the_call():
    answer = ultralytics_results(SIZE, BOXES, classes=[0, 1])
    assert detections_from(answer, SIZE, ["a", "b"]).labels == ("cup", "tv")
    answer.names = None
    assert detections_from(answer, SIZE, ["a", "b"]).labels == ("a", "b")


def test_automatic_masks_of_sam_also_as_run_lengths():
    found = detections_from(sam_masks(MASKS, [0.75, 1.02]), SIZE)
    np.testing.assert_array_equal(found.masks, MASKS)
    assert found.labels == ("object", "object")
    assert found.scores.tolist() == [0.75, 1.0]
    for as_counts in (str, str.encode):
        codes = [making.run_lengths(mask) for mask in MASKS]
        answer = [{"segmentation": {**c, "counts": as_counts(c["counts"])}} for c in codes]
        found = detections_from(answer, SIZE)
        np.testing.assert_array_equal(found.masks, MASKS)
        assert found.scores.tolist() == [1.0, 1.0]


@pytest.mark.parametrize(
    ("segmentation", "sentence"),
    [
        (None, "mask 0 is object"),
        (np.zeros(SIZE), "mask 0 is float64"),
        (np.zeros((2, 2), bool), "mask 0 is 2x2, its frame is 48x32"),
        ({"size": [4, 6]}, "counts"),
        ({"size": [4, 6], "counts": b"\xff"}, "run-length code"),
    ],
)
def test_masks_of_sam_that_are_none(segmentation, sentence):
    answer = sam_masks(MASKS)
    answer[0]["segmentation"] = segmentation
    with pytest.raises(SourceError, match=sentence):
        detections_from(answer, SIZE)
