import cv2
import numpy as np
import pytest

from remind_jax.errors import SourceError
from remind_jax.sources import detections_from
from tests.sources import making
from tests.sources.published import sam_masks, ultralytics_results
from tests.sources.test_coco_masks import encode

SIZE = making.SIZE
MASKS = np.stack([making.instance_map() == i for i in (1, 2)])
BOXES = [[1.0, 2.0, 9.0, 12.0], [20.0, 4.0, 40.0, 30.0]]


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
        codes = [encode(mask) for mask in MASKS]
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


def test_compact_masks_of_supervision():
    sv = pytest.importorskip("supervision")
    compact = sv.CompactMask.from_dense(MASKS, np.array(BOXES), image_shape=SIZE)
    whole = sv.Detections(xyxy=np.array([[0, 0, 48, 32]] * 2, float), mask=MASKS)
    np.testing.assert_array_equal(detections_from(whole, SIZE).masks, MASKS)
    answer = sv.Detections(xyxy=np.array(BOXES), mask=compact)
    np.testing.assert_array_equal(detections_from(answer, SIZE).masks, compact.to_dense())
