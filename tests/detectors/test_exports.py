import json
from pathlib import Path

import pytest

from remind_jax.detectors import as_detector
from remind_jax.detectors.exports import read_class_names
from remind_jax.errors import WeightsError


def test_names_are_read_from_all_known_forms():
    for metadata, expected in (
        ({"names": "{0: 'person', 7: \"potted plant\"}"}, {0: "person", 7: "potted plant"}),
        ({"names": '["cup", "chair"]'}, {0: "cup", 1: "chair"}),
        ({"names": '{"0": "cup"}'}, {0: "cup"}),
        ({"rfdetr_inference": json.dumps({"class_id_to_name": {"1": "cup"}})}, {1: "cup"}),
        ({}, {}),
        ({"names": ""}, {}),
        ({"names": "person"}, {}),
        ({"names": "{'a': 'b'}"}, {}),
        ({"names": "[" * 100_000}, {}),
        ({"rfdetr_inference": "[]"}, {}),
    ):
        assert read_class_names(metadata) == expected


def test_nothing_in_a_file_is_executed(tmp_path):
    target = tmp_path / "made"
    assert read_class_names({"names": f"{{0: open({str(target)!r}, 'w')}}"}) == {}
    assert not target.exists()


@pytest.mark.parametrize("is_there", [False, True])
def test_another_format_is_refused_with_how_to_export(tmp_path, is_there):
    for suffix in ("pt", "PT", "torchscript", "engine", "tflite", "mlmodel", "xml"):
        path = tmp_path / f"yolo11n-seg.{suffix}"
        if is_there:
            path.write_bytes(b"a model")
        with pytest.raises(WeightsError) as caught:
            as_detector(path)
        assert f"'{path}' is no ONNX file" in str(caught.value)
        assert "yolo export model=yolo11n-seg.pt format=onnx" in str(caught.value)


def test_a_network_of_rf_detr_is_told_how_it_is_exported(tmp_path):
    with pytest.raises(WeightsError, match=r'RFDETRSegMedium\(pretrain_weights="mine.pth"\)'):
        as_detector(Path("mine.pth"))
    for name, call in (
        ("rfdetr-seg-nano", "rfdetr.RFDETRSegNano().export()"),
        ("rfdetr-seg-2xlarge.onnx", "rfdetr.RFDETRSeg2XLarge().export()"),
        ("rf-detr-seg-xxlarge.pt", 'RFDETRSeg2XLarge(pretrain_weights="rf-detr-seg-xxlarge.pt")'),
        ("RF-DETR-Seg-XLarge.onnx", "rfdetr.RFDETRSegXLarge().export()"),
    ):
        with pytest.raises(WeightsError) as caught:
            as_detector(tmp_path / name)
        assert call in str(caught.value)
        assert "yolo" not in str(caught.value)


def test_what_is_not_there_is_refused_with_how_to_make_it(tmp_path):
    with pytest.raises(WeightsError, match=r"does not exist; .* model=yolo11n-seg.pt format=onnx"):
        as_detector(tmp_path / "yolo11n-seg.onnx")
    with pytest.raises(WeightsError, match="is a folder"):
        as_detector(tmp_path)
