import json
from pathlib import Path

import numpy as np
import pytest
from scipy.special import logit

from remind_jax.detectors import DetectorOptions
from remind_jax.detectors.onnx_model import Signature, TensorSpec
from remind_jax.detectors.rfdetr_seg import RfDetrSeg, name_columns, recognize_rfdetr_seg
from remind_jax.errors import ConfigError, WeightsError


def specs(**shapes) -> list[TensorSpec]:
    return [TensorSpec(name, shape, "float32") for name, shape in shapes.items()]


OUTPUTS = specs(dets=(1, 5, 4), labels=(1, 5, 4), masks=(1, 5, 12, 12))


def head_of(options=None, metadata=None, input_shape=(1, 3, 48, 48)) -> RfDetrSeg:
    layout = recognize_rfdetr_seg(OUTPUTS)
    images = TensorSpec("input", input_shape, "float32")
    file = Signature(Path("m.onnx"), (images,), tuple(OUTPUTS), metadata or {})
    return RfDetrSeg.from_file(file, layout, options or DetectorOptions())


@pytest.mark.parametrize(
    ("outputs", "expected"),
    [
        (OUTPUTS, ("dets", "labels", "masks", 4)),  # labels as wide as boxes: names decide
        (OUTPUTS[::-1], ("dets", "labels", "masks", 4)),
        (
            specs(**{"dets": (None, None, 4), "labels": (None, None, 91), "4245": (1, None, 9, 9)}),
            ("dets", "labels", "4245", 91),
        ),
        (specs(a=(1, 5, 91), b=(1, 5, 4), c=(1, 5, 12, 12)), ("b", "a", "c", 91)),
        (specs(a=(1, 5, 4), b=(1, 5, 4), c=(1, 5, 12, 12)), ("a", "b", "c", 4)),
        (specs(dets=(1, 5, 4), labels=(1, 5, 91)), None),
        (specs(a=(1, 5, 7), b=(1, 5, 9), c=(1, 5, 12, 12)), None),
        (specs(a=(1, 5, 4), b=(1, 5, 9), c=(1, 5, 12)), None),
    ],
)
def test_outputs_are_told_by_name_then_shape_then_order(outputs, expected):
    layout = recognize_rfdetr_seg(outputs)
    found = layout and (layout.boxes, layout.labels, layout.masks, layout.num_columns)
    assert found == expected


def answer() -> dict[str, np.ndarray]:
    """Four instances and an empty query; each mask is one quarter of the frame."""
    labels = np.full((1, 5, 4), logit(0.01), np.float32)
    labels[0, 0, [0, 1]] = logit([0.6, 0.5])  # two classes: the better one counts
    labels[0, 1, 1] = logit(0.9)
    labels[0, 2, [2, 0]] = logit([0.8, 0.7])
    labels[0, 3, [3, 0]] = logit([0.95, 0.3])  # the last column: no object
    masks = np.full((1, 5, 12, 12), -6.0, np.float32)
    for query, (top, left) in enumerate([(0, 0), (0, 6), (6, 0), (6, 6)]):
        masks[0, query, top : top + 6, left : left + 6] = 6.0
    return {"dets": np.zeros((1, 5, 4), np.float32), "labels": labels, "masks": masks}


NAMED = {"rfdetr_inference": json.dumps({"class_id_to_name": {"0": "cup", "1": "bed", "2": "tv"}})}


@pytest.mark.parametrize(
    ("options", "metadata", "expected"),
    [
        ({}, NAMED, [("bed", 0.9), ("tv", 0.8), ("cup", 0.6), ("cup", 0.3)]),
        ({}, {}, [("class_1", 0.9), ("class_2", 0.8), ("class_0", 0.6), ("class_0", 0.3)]),
        ({"confidence": 0.61}, NAMED, [("bed", 0.9), ("tv", 0.8)]),
        ({"max_detections": 1}, NAMED, [("bed", 0.9)]),
        # An unwanted class is not replaced by the second best.
        ({"ignored_classes": ("TV",)}, NAMED, [("bed", 0.9), ("cup", 0.6), ("cup", 0.3)]),
        ({"classes": ("bed",)}, NAMED, [("bed", 0.9)]),
        (
            {"class_names": ("a", "b", "c", "d")},
            NAMED,
            [("d", 0.95), ("b", 0.9), ("c", 0.8), ("a", 0.6)],
        ),
        ({"class_names": ("a",)}, {}, [("a", 0.7), ("a", 0.6), ("a", 0.3)]),
    ],
)
def test_each_query_counts_once_under_its_best_class(options, metadata, expected):
    found = head_of(DetectorOptions(**options), metadata).decode(answer(), (48, 64))
    scores = [round(float(score), 3) for score in found.scores]
    assert list(zip(found.labels, scores, strict=True)) == expected


def test_masks_fill_the_frame_without_letterbox():
    outputs = answer()
    outputs["masks"][0, 0] = np.where(np.arange(12) < 6, 6.0, -6.0)  # left half
    outputs["masks"][0, 1] = np.where(np.arange(12) < 3, 6.0, -6.0)[:, None]  # upper quarter
    bed, _, cup, _ = head_of(None, NAMED).decode(outputs, (50, 80)).masks
    rows, columns = np.indices((50, 80)) + 0.5
    np.testing.assert_array_equal(cup, columns < 40)
    np.testing.assert_array_equal(bed, rows <= 12.5)


def test_the_mask_threshold_is_a_probability():
    outputs = answer()
    outputs["masks"][:] = logit(0.7)
    assert np.all(head_of(DetectorOptions(mask_threshold=0.69)).decode(outputs, (9, 9)).masks)
    assert not np.any(head_of(DetectorOptions(mask_threshold=0.71)).decode(outputs, (9, 9)).masks)


def test_ninety_one_columns_are_coco_categories():
    names = name_columns(91, {})
    assert len(names) == 91
    assert sum(name is not None for name in names) == 80
    known = {0: None, 1: "person", 12: None, 44: "bottle", 62: "chair", 90: "toothbrush"}
    assert {column: names[column] for column in known} == known
    assert name_columns(91, {5: "cup"})[1] is None


def test_the_input_is_normalized_and_stretched():
    image = np.zeros((30, 70, 3), np.uint8)
    image[:, :35] = (255, 0, 51)
    tensor = head_of().prepare(image)
    assert tensor.shape == (1, 3, 48, 48)
    assert tensor.dtype == np.float32
    # float32 rounding.
    np.testing.assert_allclose(
        tensor[0, :, 24, 3], [(1 - 0.485) / 0.229, -0.456 / 0.224, (0.2 - 0.406) / 0.225], atol=1e-5
    )
    np.testing.assert_allclose(tensor[0, 0, 24, 45], -0.485 / 0.229, atol=1e-5)


def test_what_does_not_fit_is_refused():
    with pytest.raises(ConfigError, match=r"5 class_names were given.*4 class columns"):
        head_of(DetectorOptions(class_names=("a", "b", "c", "d", "e")))
    with pytest.raises(ConfigError, match="leaves its input size open"):
        head_of(input_shape=(1, 3, None, None))
    resized = head_of(DetectorOptions(input_size_px=64), input_shape=(1, 3, None, None))
    assert resized.input_size == (64, 64)
    outputs = {**answer(), "labels": np.zeros((1, 5, 7), np.float32)}
    with pytest.raises(WeightsError, match=r"labels \[1, 5, 7\]"):
        head_of().decode(outputs, (9, 9))
