from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.special import expit

from remind_jax.detectors import DetectorOptions
from remind_jax.detectors.onnx_model import Signature, TensorSpec
from remind_jax.detectors.yolo_seg import (
    Candidates,
    YoloSeg,
    choose_input_size,
    decode_masks,
    read_candidates,
    recognize_yolo_seg,
    suppress_duplicates,
)
from remind_jax.errors import ConfigError, WeightsError
from remind_jax.masks.letterbox import Letterbox


def specs(*shapes) -> list[TensorSpec]:
    return [TensorSpec(f"output{i}", shape, "float32") for i, shape in enumerate(shapes)]


def head_of(outputs, options=None, metadata=None, input_shape=(1, 3, 96, 128)) -> YoloSeg:
    layout = recognize_yolo_seg(outputs)
    images = TensorSpec("images", input_shape, "float32")
    file = Signature(Path("m.onnx"), (images,), tuple(outputs), metadata or {})
    return YoloSeg.from_file(file, layout, options or DetectorOptions())


V8 = specs((1, 4 + 3 + 2, 50), (1, 2, 24, 32))  # 3 classes, 2 prototypes
SUPPRESSED = specs((1, 10, 6 + 2), (1, 2, 24, 32))
NAMES = {"names": "{0: 'cup', 1: 'chair', 2: 'wall'}"}


@pytest.mark.parametrize(
    ("outputs", "expected"),
    [
        (specs((1, 116, 8400), (1, 32, 160, 160)), (32, 80, False)),  # v8 and v11
        (specs((1, 32, 80, 80), (1, 37, 2100)), (32, 1, False)),  # one class, other order
        (specs((None, 116, None), (None, 32, None, None)), (32, 80, False)),  # dynamic export
        (specs((1, 300, 38), (1, 32, 160, 160)), (32, None, True)),  # suppression inside
        (specs((1, 84, 8400)), None),  # boxes only
        (specs((1, 25200, 117), (1, 32, 160, 160)), None),  # YOLOv5
        (specs((1, 36, 8400), (1, 32, 160, 160)), None),  # no room for a class
        (specs((1, 116, 8400), (1, 32, 160, 160), (1, 2, 3)), None),
        (specs((1, 116, 8400), (116, 8400)), None),
    ],
)
def test_layouts_are_told_by_shapes(outputs, expected):
    layout = recognize_yolo_seg(outputs)
    found = layout and (layout.num_coefficients, layout.num_classes, layout.suppressed)
    assert found == expected


@pytest.mark.parametrize(
    ("frame_size", "declared", "expected"),
    [
        ((480, 640), (320, 320), (320, 320)),
        ((480, 640), (None, None), (480, 640)),
        ((1080, 1920), (None, None), (384, 640)),
        ((1920, 1080), (None, None), (640, 384)),
        ((7, 1000), (None, None), (32, 640)),
        ((480, 640), (320, None), (320, 640)),
    ],
)
def test_open_sizes_follow_the_frame_in_whole_strides(frame_size, declared, expected):
    assert choose_input_size(frame_size, declared, 640, 32) == expected


def test_candidates_are_read_and_filtered():
    rows = np.zeros((9, 5), np.float32)
    rows[:4] = np.array([[50, 40, 20, 10]]).T
    rows[4:7, 0] = [0.1, 0.9, 0.3]
    rows[4:7, 1] = [0.25, 0.1, 0.1]  # just good enough
    rows[4:7, 2] = [0.2, 0.1, 0.9]  # not wanted; its second class is not taken instead
    rows[4:7, 3] = [0.2, 0.24, 0.1]  # too low
    rows[4:7, 4] = [0.9, 0.1, 0.1]
    rows[2, 4] = np.inf
    rows[7:, 0] = [1.5, -2.5]
    found = read_candidates(rows, 3, 0.25, np.array([True, True, False]))
    assert found.class_index.tolist() == [1, 0]
    np.testing.assert_allclose(found.scores, [0.9, 0.25])
    np.testing.assert_allclose(found.boxes[0], [40, 35, 60, 45])
    np.testing.assert_allclose(found.coefficients[0], [1.5, -2.5])


def suppress_one_by_one(boxes, scores, classes, iou) -> list[int]:
    kept: list[int] = []
    for i in np.argsort(-scores, kind="stable"):
        for j in kept:
            width, height = np.minimum(boxes[i, 2:], boxes[j, 2:]) - np.maximum(
                boxes[i, :2], boxes[j, :2]
            )
            shared = max(0, width) * max(0, height)
            areas = [np.prod(boxes[k, 2:] - boxes[k, :2]) for k in (i, j)]
            if classes[i] == classes[j] and shared / (sum(areas) - shared) > iou:
                break
        else:
            kept.append(int(i))
    return kept


@given(seed=st.integers(0, 10_000), num=st.integers(0, 30), agnostic=st.booleans())
def test_suppression_equals_a_plain_loop(seed, num, agnostic):
    rng = np.random.default_rng(seed)
    near = rng.uniform(-30, 60, (num, 2))
    boxes = np.concatenate([near, near + rng.uniform(5, 60, (num, 2))], axis=1)
    scores, classes = rng.uniform(0.1, 1, num), rng.integers(0, 3, num)
    candidates = Candidates(boxes, scores, classes, np.arange(num)[:, None].astype(float))
    options = DetectorOptions(iou=0.4, suppress_across_classes=agnostic)
    kept = suppress_duplicates(candidates, options).coefficients[:, 0]
    expected = suppress_one_by_one(boxes, scores, np.zeros(num) if agnostic else classes, 0.4)
    assert sorted(kept.astype(int)) == sorted(expected)


def test_boxes_beyond_the_border_stay_apart_by_class():
    """OpenCV shifts classes by the largest coordinate: these two would meet exactly."""
    boxes = np.array([[90, 0, 100, 10], [-11, -101, -1, -91]], float)
    candidates = Candidates(boxes, np.array([0.9, 0.8]), np.array([0, 1]), np.zeros((2, 1)))
    assert len(suppress_duplicates(candidates, DetectorOptions()).scores) == 2


def sample_bilinear(plane: np.ndarray, y: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Values at index coordinates on a grid of rows `y` and columns `x`, constant outside."""
    y, x = np.clip(y, 0, plane.shape[0] - 1), np.clip(x, 0, plane.shape[1] - 1)
    columns = [np.interp(y, np.arange(plane.shape[0]), column) for column in plane.T]
    return np.array([np.interp(x, np.arange(plane.shape[1]), row) for row in np.array(columns).T])


@pytest.mark.parametrize("frame_size", [(96, 128), (360, 640), (481, 333), (50, 77)])
def test_masks_equal_an_independent_decode(frame_size):
    rng = np.random.default_rng(3)
    letterbox = Letterbox.fit(frame_size, (96, 128))
    prototypes = rng.normal(size=(2, 24, 32)).astype(np.float32)
    coefficients = rng.normal(size=(3, 2)).astype(np.float32)
    boxes = np.array([[0, 0, 128, 96], [40.3, 30.2, 77.7, 60.4], [100, 80, 140, 120.0]])
    candidates = Candidates(boxes, np.ones(3), np.zeros(3, int), coefficients)
    masks = decode_masks(candidates, prototypes, letterbox, 0.6)
    height, width = frame_size
    scale_y, scale_x = np.divide(letterbox.scaled_size, frame_size)
    y = (np.arange(height) + 0.5) * scale_y - 0.5
    x = (np.arange(width) + 0.5) * scale_x - 0.5
    for row in range(3):
        logits = np.einsum("m,mij->ij", coefficients[row], prototypes)
        at_input = sample_bilinear(
            logits, (np.arange(96) + 0.5) / 4 - 0.5, (np.arange(128) + 0.5) / 4 - 0.5
        )
        rows = slice(letterbox.top_px, letterbox.top_px + letterbox.scaled_size[0])
        columns = slice(letterbox.left_px, letterbox.left_px + letterbox.scaled_size[1])
        probability = expit(sample_bilinear(at_input[rows, columns], y, x))
        x0, y0, x1, y1 = boxes[row]
        in_x = (np.arange(width) + 0.5) * scale_x + letterbox.left_px
        in_y = (np.arange(height) + 0.5) * scale_y + letterbox.top_px
        in_box = ((in_y >= y0) & (in_y < y1))[:, None] & (in_x >= x0) & (in_x < x1)
        # OpenCV interpolates in float32: pixels closer to the threshold than this may differ.
        clear = np.abs(probability - 0.6) > 1e-4
        np.testing.assert_array_equal(masks[row][clear], ((probability >= 0.6) & in_box)[clear])
        assert clear.mean() > 0.99


def raw_outputs() -> dict[str, np.ndarray]:
    """Two overlapping cups, a chair on one of them, a wall; prototype 0 is a filled plane."""
    rows = np.zeros((1, 9, 50), np.float32)
    for column, (box, class_index, score) in enumerate(
        [
            ((64, 48, 40, 40), 0, 0.6),
            ((65, 48, 40, 40), 0, 0.8),
            ((65, 48, 40, 40), 1, 0.7),
            ((20, 20, 16, 16), 2, 0.9),
        ]
    ):
        rows[0, :4, column] = box
        rows[0, 4 + class_index, column] = score
        rows[0, 7, column] = 1.0
    prototypes = np.zeros((1, 2, 24, 32), np.float32)
    prototypes[0, 0] = 5.0
    return {"output0": rows, "output1": prototypes}


@pytest.mark.parametrize(
    ("options", "expected"),
    [
        ({}, ["wall", "cup", "chair"]),
        ({"suppress_across_classes": True}, ["wall", "cup"]),
        ({"ignored_classes": ("WALL",)}, ["cup", "chair"]),
        ({"ignored_classes": ("cup",), "suppress_across_classes": True}, ["wall", "chair"]),
        ({"classes": ("chair",)}, ["chair"]),
        ({"max_detections": 2}, ["wall", "cup"]),
        ({"confidence": 0.75}, ["wall", "cup"]),
        ({"iou": 0.99}, ["wall", "cup", "chair", "cup"]),
        ({"class_names": ("mug", "seat", "wall")}, ["wall", "mug", "seat"]),
        ({"confidence": 0.95}, []),
    ],
)
def test_options_decide_which_instances_come_out(options, expected):
    head = head_of(V8, DetectorOptions(**options), NAMES)
    found = head.decode(raw_outputs(), (96, 128))
    assert list(found.labels) == expected
    assert found.scores.tolist() == sorted(found.scores.tolist(), reverse=True)
    assert found.masks.shape == (len(expected), 96, 128)


def test_a_filled_plane_gives_exactly_the_box():
    found = head_of(V8, None, NAMES).decode(raw_outputs(), (192, 256))
    ys, xs = np.nonzero(found.masks[1])
    assert (xs.min(), ys.min(), xs.max() + 1, ys.max() + 1) == (90, 56, 170, 136)


def test_heads_with_suppression_inside_give_the_same_instances():
    raw = raw_outputs()
    rows = np.zeros((1, 10, 8), np.float32)
    rows[0, 0] = [45, 28, 85, 68, 0.8, 0, 1, 0]
    rows[0, 1] = [45, 28, 85, 68, 0.7, 1, 1, 0]
    rows[0, 2] = [12, 12, 28, 28, 0.9, 2, 1, 0]
    ours = head_of(SUPPRESSED, None, NAMES).decode({**raw, "output0": rows}, (96, 128))
    theirs = head_of(V8, None, NAMES).decode(raw, (96, 128))
    assert ours.labels == theirs.labels
    np.testing.assert_array_equal(ours.masks, theirs.masks)
    without_names = head_of(SUPPRESSED).decode({**raw, "output0": rows}, (96, 128))
    assert without_names.labels == ("class_2", "class_0", "class_1")


def test_options_that_do_not_fit_the_network_are_refused():
    with pytest.raises(ConfigError, match=r"2 class_names were given, but 'm\.onnx' has 3"):
        head_of(V8, DetectorOptions(class_names=("a", "b")))
    with pytest.raises(ConfigError, match="did you mean 'chair'"):
        head_of(V8, DetectorOptions(classes=("chairs",)), NAMES)


def test_open_input_sizes_are_taken_from_options_then_metadata():
    open_size = (1, 3, None, None)
    metadata = {"imgsz": "[320, 320]", "stride": "32"}
    image = np.zeros((90, 160, 3), np.uint8)
    assert head_of(V8, None, metadata, open_size).prepare(image).shape == (1, 3, 192, 320)
    options = DetectorOptions(input_size_px=160)
    assert head_of(V8, options, metadata, open_size).prepare(image).shape == (1, 3, 96, 160)
    assert head_of(V8, None, {"imgsz": "?"}, open_size).prepare(image).shape == (1, 3, 384, 640)


def test_the_input_is_rgb_in_zero_to_one_with_gray_bars():
    image = np.zeros((96, 96, 3), np.uint8)
    image[..., 0], image[..., 2] = 255, 51
    tensor = head_of(V8).prepare(image)
    assert tensor.dtype == np.float32
    # float32 rounding of 1 / 255.
    np.testing.assert_allclose(tensor[0, :, 48, 64], [1.0, 0.0, 0.2], atol=1e-6)
    np.testing.assert_allclose(tensor[0, :, 48, 3], 114 / 255, atol=1e-6)


def test_outputs_of_other_shapes_than_declared_are_refused():
    outputs = {**raw_outputs(), "output1": np.zeros((1, 5, 24, 32), np.float32)}
    with pytest.raises(WeightsError, match=r"\[1, 9, 50\] and \[1, 5, 24, 32\]"):
        head_of(V8).decode(outputs, (96, 128))


def test_numbers_that_are_not_finite_give_no_instances():
    outputs = {name: np.full_like(array, np.nan) for name, array in raw_outputs().items()}
    assert len(head_of(V8).decode(outputs, (96, 128))) == 0
