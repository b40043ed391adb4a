import json

import numpy as np
import pytest

from remind_jax.detectors import (
    CallableDetector,
    Detector,
    DetectorOptions,
    DropCounts,
    OnnxDetector,
    as_detector,
)
from remind_jax.detectors.detector import refine_detections
from remind_jax.errors import ConfigError, SourceError, WeightsError
from remind_jax.frame import Detections

from .onnx_bytes import model, node, write_echo, write_fixed_answer
from .test_rfdetr_seg import NAMED, answer
from .test_yolo_seg import NAMES, raw_outputs

FRAME = np.zeros((192, 256, 3), np.uint8)


def test_a_yolo_file_becomes_a_detector(tmp_path):
    path = write_fixed_answer(tmp_path / "yolo.onnx", raw_outputs(), (1, 3, 96, 128), NAMES)
    detector = as_detector(str(path), {"ignored_classes": ["chair"]})
    assert isinstance(detector, Detector)
    found = detector(FRAME)
    assert found.labels == ("wall", "cup")
    # Boxes of 32 and 80 pixels in the frame, two pixels eroded from every side.
    assert np.asarray(found.masks).sum(axis=(1, 2)).tolist() == [28**2, 76**2]
    assert detector.dropped.total() == 0
    described = json.loads(json.dumps(detector.describe()))
    assert described["kind"] == "yolo-seg"
    assert described["classes"] == ["cup", "chair", "wall"]
    assert described["options"]["erosion_px"] == 2


@pytest.mark.parametrize(
    ("shape", "changes", "why"),
    [
        ((1, 3, 10**6, 10**6), {}, "at most 8192 a side"),
        ((1, 3, "h", "w"), {"imgsz": "[1000000000, 64]"}, "says imgsz 1000000000"),
        ((1, 3, "h", "w"), {"stride": "1000000000"}, "says stride 1000000000"),
    ],
)
def test_a_network_that_asks_for_giant_images_is_refused(tmp_path, shape, changes, why):
    path = write_fixed_answer(tmp_path / "yolo.onnx", raw_outputs(), shape, NAMES | changes)
    with pytest.raises(WeightsError, match=why):
        as_detector(path)


@pytest.mark.parametrize("name", ["", "x" * 201, None, 5])
def test_classes_without_a_sound_name_are_numbered(tmp_path, name):
    names = {"names": repr({0: name, 1: "chair", 2: "wall"})}
    path = write_fixed_answer(tmp_path / "yolo.onnx", raw_outputs(), (1, 3, 96, 128), names)
    assert OnnxDetector(path).describe()["classes"] == ["class_0", "chair", "wall"]


def test_scores_beyond_one_are_refused(tmp_path):
    answers = {name: 9 * array for name, array in raw_outputs().items()}
    path = write_fixed_answer(tmp_path / "yolo.onnx", answers, (1, 3, 96, 128), NAMES)
    with pytest.raises(WeightsError, match="scores are at most 1"):
        OnnxDetector(path)(FRAME)


def test_an_rfdetr_file_becomes_a_detector(tmp_path):
    path = write_fixed_answer(tmp_path / "rfdetr.onnx", answer(), (1, 3, 48, 48), NAMED)
    detector = OnnxDetector(path, DetectorOptions(erosion_px=0))
    assert detector(FRAME).labels == ("bed", "tv", "cup", "cup")
    assert detector.describe()["kind"] == "rfdetr-seg"


def test_instances_that_erode_to_nothing_are_counted_over_frames(tmp_path):
    path = write_fixed_answer(tmp_path / "yolo.onnx", raw_outputs(), (1, 3, 96, 128), NAMES)
    detector = OnnxDetector(path, DetectorOptions(erosion_px=16))
    for _ in range(3):
        assert detector(FRAME).labels == ("cup", "chair")
    assert (detector.dropped["eroded"], detector.dropped.total()) == (3, 3)


def test_an_unknown_network_is_told_what_is_known(tmp_path):
    path = write_echo(tmp_path / "other.onnx", (1, 3, 96, 128))
    with pytest.raises(WeightsError) as caught:
        as_detector(path)
    message = str(caught.value)
    assert "echo [1, 3, 96, 128]" in message
    assert "YOLO-seg [1, 4+C+M, A]" in message
    assert "RF-DETR-seg dets [1, Q, 4]" in message


def test_inputs_other_than_one_rgb_image_are_refused(tmp_path):
    path, shape = tmp_path / "odd.onnx", (1, 3, 6, 8)
    for odd in ((4, 3, 96, 128), (1, 1, 96, 128), (1, 96, 128)):
        write_fixed_answer(path, raw_outputs(), odd, NAMES)
        with pytest.raises(WeightsError, match="a detector has one, an RGB image"):
            as_detector(path)
    two = model([node("Add", ["a", "b"], "sum")], {"a": shape, "b": shape}, {"sum": shape})
    path.write_bytes(two)
    with pytest.raises(WeightsError, match=r"inputs a \[1, 3, 6, 8\] of float, b"):
        as_detector(path)


@pytest.mark.usefixtures("unchecked_shapes")
def test_frames_that_are_no_rgb_image_are_refused():
    detector = CallableDetector(lambda image: None)
    others = np.zeros((4, 4, 4), np.uint8), np.zeros((0, 4, 3), np.uint8), None
    for image in (FRAME.astype(np.float32), FRAME[..., 0], *others):
        with pytest.raises(SourceError, match=r"uint8 \[H, W, 3\]|frames of 4x0 pixels"):
            detector(image)


def one_dot(image: np.ndarray) -> Detections:
    masks = np.zeros((2, *image.shape[:2]), bool)
    masks[0, 3, 3] = True
    masks[1, :9, :9] = True
    return Detections.create(masks, ["dot", "Wall"], [0.1, 0.6], [4, 5])


def test_a_callable_keeps_its_masks_unless_asked_otherwise():
    plain = as_detector(one_dot)
    assert np.asarray(plain(FRAME).masks).sum(axis=(1, 2)).tolist() == [1, 81]
    assert plain(FRAME).instance_ids.tolist() == [4, 5]
    assert plain.describe()["function"] == "one_dot"
    strict = as_detector(one_dot, DetectorOptions(confidence=0.0, ignored_classes=("wall",)))
    assert len(strict(FRAME)) == 0
    assert strict.dropped["eroded"] == 1
    json.dumps(strict.describe())


def test_a_class_says_what_it_is():
    class Dots:
        def __call__(self, image):
            return np.asarray(one_dot(image).masks)

        def describe(self):
            return {"kind": "dots", "size": 9}

    dots = as_detector(Dots())
    assert len(dots(FRAME)) == 2
    told = dots.describe()
    assert (told["kind"], told["size"]) == ("dots", 9)
    assert told["function"].endswith("Dots")


def test_a_callable_may_answer_in_any_known_form():
    def boxes_only(image):
        return {"boxes": [[2, 3, 12, 9]], "class_ids": [1], "scores": [0.5]}

    plain = as_detector(boxes_only)
    named = as_detector(boxes_only, DetectorOptions(class_names=("cup", "chair")))
    assert np.asarray(plain(FRAME).masks).sum() == 60
    assert plain(FRAME).labels == ("1",)
    assert np.asarray(named(FRAME).masks).sum() == 6 * 2
    assert named(FRAME).labels == ("chair",)
    own_names = as_detector(lambda image: boxes_only(image) | {"class_names": np.array(["a", "b"])})
    assert own_names(FRAME).labels == ("b",)
    nothing = as_detector(lambda image: None)
    assert nothing(FRAME).masks.shape == (0, 192, 256)


@pytest.mark.parametrize("layout", [(0, 1, 2), (1, 2, 0)])
def test_masks_may_lie_in_memory_in_any_order(layout):
    detector = CallableDetector(
        lambda image: (
            np.asarray(one_dot(image).masks).transpose(layout).copy().transpose(np.argsort(layout))
        ),
        DetectorOptions(),
    )
    assert np.asarray(detector(FRAME).masks).sum(axis=(1, 2)).tolist() == [49]


def test_none_detectors_and_nonsense():
    assert as_detector(None) is None
    detector = CallableDetector(one_dot)
    assert as_detector(detector) is detector
    with pytest.raises(ConfigError, match="cannot be made from int"):
        as_detector(3)


def square(size: int, top: int, left: int) -> np.ndarray:
    mask = np.zeros((20, 30), bool)
    mask[top : top + size, left : left + size] = True
    return mask


def test_every_drop_is_counted_by_its_reason_and_the_order_stays():
    squares, labels, scores = zip(
        (square(7, 5, 6), "cup", 0.5),  # 9 pixels left
        (square(4, 2, 2), "cup", 0.9),  # eroded away
        (square(0, 0, 0), "cup", 0.9),  # empty from the start
        (square(5, 8, 8), "cup", 0.9),  # 1 pixel left: too small
        (square(9, 8, 8), "chair", 0.8),  # 25 pixels left
        (square(9, 0, 9), "Wall", 0.9),  # ignored class
        (square(9, 0, 9), "cup", 0.2),  # score too low
        strict=True,
    )
    detections = Detections.create(np.stack(squares), labels, scores)
    options = DetectorOptions(min_mask_px=2, ignored_classes=("wall",))
    kept, drops = refine_detections(detections, options)
    assert kept.labels == ("cup", "chair")
    assert kept.scores.tolist() == [np.float32(0.5), np.float32(0.8)]
    assert np.asarray(kept.masks).sum(axis=(1, 2)).tolist() == [9, 25]
    assert drops == DropCounts(empty=1, eroded=1, small=1)
    kept, drops = refine_detections(Detections.empty(4, 6), DetectorOptions())
    assert (kept.masks.shape, drops.total()) == ((0, 4, 6), 0)
