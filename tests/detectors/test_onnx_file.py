import contextlib

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from remind_jax.detectors.onnx_file import OnnxFile, TensorSpec
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


@pytest.mark.parametrize("name", ["absent.onnx", "."])
def test_a_missing_file_is_named(tmp_path, name):
    with pytest.raises(WeightsError, match="does not exist"):
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
