import importlib.util

import numpy as np
import pytest

from remind_jax.detectors.onnx_file import OnnxFile
from remind_jax.detectors.onnx_session import OnnxSession
from remind_jax.errors import ConfigError, WeightsError

from .onnx_bytes import write_echo, write_fixed_answer

HAS_ONNXRUNTIME = importlib.util.find_spec("onnxruntime") is not None
needs_onnxruntime = pytest.mark.skipif(not HAS_ONNXRUNTIME, reason="onnxruntime is not installed")
engines = pytest.mark.parametrize(
    "engine", [pytest.param("onnxruntime", marks=needs_onnxruntime), "cv2.dnn"]
)


def open_model(path, engine="auto") -> OnnxSession:
    return OnnxSession(OnnxFile.read(path), engine, num_threads=1)


def hide_onnxruntime(monkeypatch):
    find = importlib.util.find_spec
    monkeypatch.setattr(
        importlib.util, "find_spec", lambda name: None if name == "onnxruntime" else find(name)
    )


@engines
def test_both_engines_run_a_model(tmp_path, engine):
    tensor = np.random.default_rng(0).normal(size=(1, 3, 6, 8)).astype(np.float32)
    session = open_model(write_echo(tmp_path / "echo.onnx", (1, 3, 6, 8)), engine)
    assert session.engine == engine
    outputs = session(tensor)
    np.testing.assert_array_equal(outputs["echo"], np.maximum(tensor, 0))


@engines
def test_outputs_keep_their_names(tmp_path, engine):
    answers = {
        name: np.full((1, 2, size), size, float) for size, name in ((3, "z"), (4, "a"), (5, "m"))
    }
    path = write_fixed_answer(tmp_path / "three.onnx", answers, (1, 3, 6, 8))
    outputs = open_model(path, engine)(np.zeros((1, 3, 6, 8), np.float32))
    assert list(outputs) == ["z", "a", "m"]
    for name, array in answers.items():
        np.testing.assert_array_equal(outputs[name], array)


def test_without_onnxruntime_cv2_takes_over(tmp_path, monkeypatch):
    hide_onnxruntime(monkeypatch)
    path = write_echo(tmp_path / "echo.onnx", (1, 3, 6, 8))
    assert open_model(path).engine == "cv2.dnn"
    with pytest.raises(ConfigError, match=r"not installed; pip install 'remind-jax\[detect\]'"):
        open_model(path, "onnxruntime")


def test_cv2_names_the_operator_that_it_lacks_and_prints_nothing(tmp_path, capfd):
    path = write_echo(tmp_path / "odd.onnx", (1, 3, 6, 8), operator="NoSuchOperator")
    with pytest.raises(
        WeightsError, match=r"operator NoSuchOperator.*use onnxruntime: pip install"
    ):
        open_model(path, "cv2.dnn")
    assert capfd.readouterr() == ("", "")


@needs_onnxruntime
def test_onnxruntime_failures_are_one_sentence(tmp_path, capfd):
    path = write_echo(tmp_path / "odd.onnx", (1, 3, 6, 8), operator="NoSuchOperator")
    with pytest.raises(WeightsError, match=r"cannot load .*odd\.onnx") as caught:
        open_model(path, "onnxruntime")
    assert "\n" not in str(caught.value)
    session = open_model(write_echo(tmp_path / "echo.onnx", (1, 3, 6, 8)), "onnxruntime")
    with pytest.raises(WeightsError, match=r"on an input of shape \[1, 3, 9, 9\]") as caught:
        session(np.zeros((1, 3, 9, 9), np.float32))
    assert "\n" not in str(caught.value)
    assert capfd.readouterr() == ("", "")
