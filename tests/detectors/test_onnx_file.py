import contextlib
import json
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from remind_jax.detectors import as_detector
from remind_jax.detectors.onnx_file import OnnxFile, TensorSpec, read_class_names
from remind_jax.errors import WeightsError

from .onnx_bytes import model, node, number, text, value_info

METADATA = {"names": "{0: 'cup'}", "größe": "ja"}
BYTES = model(
    [node("Relu", ["images"], "echo")],
    {"images": ("batch", 3, 640, "width")},
    {"echo": ("batch", 3, 640, "width")},
    metadata=METADATA,
)


def test_signature_and_metadata_are_read(tmp_path):
    path = tmp_path / "model.onnx"
    path.write_bytes(BYTES)
    file = OnnxFile.read(path)
    assert file.inputs == (TensorSpec("images", (None, 3, 640, None), "float32"),)
    assert str(file.outputs[0]) == "echo [?, 3, 640, ?]"
    assert file.metadata == METADATA


def test_onnxruntime_reads_the_same(tmp_path):
    onnxruntime = pytest.importorskip("onnxruntime")
    path = tmp_path / "model.onnx"
    path.write_bytes(BYTES)
    session = onnxruntime.InferenceSession(str(path), providers=["CPUExecutionProvider"])
    assert session.get_modelmeta().custom_metadata_map == OnnxFile.read(path).metadata
    assert session.get_inputs()[0].shape == ["batch", 3, 640, "width"]


def test_weights_listed_as_inputs_and_sizes_of_minus_one_are_understood(tmp_path):
    path = tmp_path / "old.onnx"
    minus_one = text(1, number(1, 2**64 - 1))
    open_size = text(1, "images") + text(2, text(1, number(1, 10) + text(2, minus_one)))
    weight = text(5, number(1, 4) + text(8, "w"))
    graph = weight + text(11, open_size) + text(11, value_info("w", (4,)))
    path.write_bytes(number(1, 3) + text(7, graph))
    assert OnnxFile.read(path).inputs == (TensorSpec("images", (None,), "float16"),)


@pytest.mark.parametrize(
    "content",
    [b"", b"hello world", b"version https://git-lfs.github.com/spec/v1\n", b"\x00" * 64, b"\x80"],
)
def test_a_file_that_is_no_model_gets_one_sentence(tmp_path, content):
    path = tmp_path / "model.onnx"
    path.write_bytes(content)
    with pytest.raises(WeightsError, match=r"model\.onnx' is not a complete ONNX file"):
        OnnxFile.read(path)


@pytest.mark.parametrize(
    ("name", "said"), [("absent.onnx", "does not exist"), (".", "is a folder; give the path of")]
)
def test_what_is_no_file_is_named(tmp_path, name, said):
    with pytest.raises(WeightsError, match=said):
        OnnxFile.read(tmp_path / name)


# The file is written anew for each example, so sharing the folder does no harm.
@settings(deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_damage_never_gives_another_kind_of_error(tmp_path, data):
    damaged = bytearray(BYTES)
    for _ in range(data.draw(st.integers(1, 4))):
        damaged[data.draw(st.integers(0, len(damaged) - 1))] = data.draw(st.integers(0, 255))
    path = tmp_path / "damaged.onnx"
    path.write_bytes(damaged[: data.draw(st.integers(1, len(damaged)))])
    with contextlib.suppress(WeightsError):
        assert all(isinstance(spec.name, str) for spec in OnnxFile.read(path).inputs)


@pytest.mark.parametrize(
    ("metadata", "expected"),
    [
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
    ],
)
def test_names_are_read_from_all_known_forms(metadata, expected):
    assert read_class_names(metadata) == expected


def test_nothing_in_a_file_is_executed(tmp_path):
    target = tmp_path / "made"
    assert read_class_names({"names": f"{{0: open({str(target)!r}, 'w')}}"}) == {}
    assert not target.exists()


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
def test_another_format_is_refused_with_how_to_export(tmp_path, name, kind, is_there):
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


@pytest.mark.parametrize(
    ("name", "call"),
    [
        ("rfdetr-seg-nano", "rfdetr.RFDETRSegNano().export()"),
        ("rfdetr-seg-2xlarge.onnx", "rfdetr.RFDETRSeg2XLarge().export()"),
        ("rf-detr-seg-xxlarge.pt", 'RFDETRSeg2XLarge(pretrain_weights="rf-detr-seg-xxlarge.pt")'),
        ("RF-DETR-Seg-XLarge.onnx", "rfdetr.RFDETRSegXLarge().export()"),
    ],
)
def test_a_network_of_rf_detr_is_told_how_it_is_exported(tmp_path, name, call):
    with pytest.raises(WeightsError) as caught:
        as_detector(tmp_path / name)
    assert call in str(caught.value)
    assert "Apache-2.0" in str(caught.value)
    assert "yolo" not in str(caught.value)


def test_what_is_not_there_is_refused_with_how_to_make_it(tmp_path):
    with pytest.raises(WeightsError, match=r"does not exist; .* model=yolo11n-seg.pt format=onnx"):
        as_detector(tmp_path / "yolo11n-seg.onnx")
    with pytest.raises(WeightsError, match="is a folder"):
        as_detector(tmp_path)
