import sys

import numpy as np
import pytest

from remind_jax.detectors.onnx_model import OnnxModel, TensorSpec
from remind_jax.errors import ConfigError, WeightsError

from .onnx_bytes import model, node, write_echo, write_fixed_answer

pytest.importorskip("onnxruntime")


def test_signature_and_metadata_are_read(tmp_path):
    path, shape = tmp_path / "model.onnx", ("batch", 3, 640, "width")
    metadata = {"names": "{0: 'cup'}", "größe": "ja"}
    path.write_bytes(
        model(
            [node("Relu", ["images"], "echo")], {"images": shape}, {"echo": shape}, None, metadata
        )
    )
    signature = OnnxModel(path).signature
    assert signature.inputs == (TensorSpec("images", (None, 3, 640, None), "float"),)
    assert str(signature.outputs[0]) == "echo [?, 3, 640, ?]"
    assert signature.metadata == metadata


def test_outputs_keep_their_names(tmp_path):
    answers = {
        name: np.full((1, 2, size), size, float) for size, name in ((3, "z"), (4, "a"), (5, "m"))
    }
    path = write_fixed_answer(tmp_path / "three.onnx", answers, (1, 3, 6, 8))
    outputs = OnnxModel(path, num_threads=1)(np.zeros((1, 3, 6, 8), np.float32))
    assert list(outputs) == ["z", "a", "m"]
    for name, array in answers.items():
        np.testing.assert_array_equal(outputs[name], array)


def test_a_file_that_is_no_model_is_refused(tmp_path, capfd):
    path = tmp_path / "model.onnx"
    for content in (b"", b"hello world", b"\x00" * 64, b"\x80"):
        path.write_bytes(content)
        with pytest.raises(WeightsError, match=r"model\.onnx' is damaged or no ONNX file"):
            OnnxModel(path)
    write_echo(path, (1, 3, 6, 8), operator="NoSuchOperator")
    with pytest.raises(WeightsError, match="onnxruntime cannot load"):
        OnnxModel(path)
    assert capfd.readouterr() == ("", "")


def test_an_input_that_does_not_fit_is_refused(tmp_path, capfd):
    echo = OnnxModel(write_echo(tmp_path / "echo.onnx", (1, 3, 6, 8)))
    with pytest.raises(WeightsError, match=r"on an input of shape \[1, 3, 9, 9\]"):
        echo(np.zeros((1, 3, 9, 9), np.float32))
    assert capfd.readouterr() == ("", "")


def test_without_onnxruntime_it_is_told_how_to_install_it(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "onnxruntime", None)
    with pytest.raises(ConfigError, match=r"not installed; pip install 'remind-jax\[detect\]'"):
        OnnxModel(write_echo(tmp_path / "echo.onnx", (1, 3, 6, 8)))
