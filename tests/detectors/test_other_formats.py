from pathlib import Path

import pytest

from remind_jax.detectors import as_detector
from remind_jax.errors import WeightsError


@pytest.mark.parametrize(
    ("name", "kind"),
    [
        ("yolo11n-seg.pt", "PyTorch"),
        ("yolo11n-seg.PT", "PyTorch"),
        ("yolo11n-seg.torchscript", "TorchScript"),
        ("yolo11n-seg.engine", "TensorRT"),
        ("yolo11n-seg.tflite", "TensorFlow Lite"),
        ("yolo11n-seg.mlmodel", "Core ML"),
        ("yolo11n-seg.xml", "OpenVINO"),
    ],
)
@pytest.mark.parametrize("is_there", [False, True])
def test_another_format_is_told_with_how_to_export(tmp_path, name, kind, is_there):
    path = tmp_path / name
    if is_there:
        path.write_bytes(b"a model")
    with pytest.raises(WeightsError) as caught:
        as_detector(path)
    assert f"'{path}' is " in str(caught.value)
    assert kind in str(caught.value)
    assert "yolo export model=yolo11n-seg.pt format=onnx" in str(caught.value)


def test_weights_of_rf_detr_are_exported_otherwise():
    with pytest.raises(WeightsError, match=r'RFDETRSegMedium\(pretrain_weights="mine.pth"\)'):
        as_detector(Path("mine.pth"))


def test_what_is_not_there_is_told_with_how_to_make_it(tmp_path):
    with pytest.raises(WeightsError, match=r"does not exist; .* model=yolo11n-seg.pt format=onnx"):
        as_detector(tmp_path / "yolo11n-seg.onnx")
    with pytest.raises(WeightsError, match="is a folder"):
        as_detector(tmp_path)
