"""`.pth` files without PyTorch: sound ones are read, all others are refused in one sentence."""

import builtins
import os
import pickle
import tracemalloc
import zipfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from remind_jax.errors import WeightsError
from tests.weights_convert.pth_files import call_of, write_pth
from weights_convert.pickled_tensors import read_pickled
from weights_convert.stored_tensors import open_source

ARRAYS = {
    "matrix": np.arange(12, dtype=np.float32).reshape(3, 4),
    "half": np.array([1.5, -2.0], np.float16),
    "scalar": np.array(7, np.int64),
    "empty": np.zeros((0, 3), np.float32),
}


def read_everything(path) -> dict:
    content = read_pickled(path)
    return {key: value.read() for key, value in content.items() if hasattr(value, "read")}


def refusal(path) -> str:
    with pytest.raises(WeightsError) as caught:
        read_everything(path)
    return str(caught.value)


def test_tensors_come_back(tmp_path):
    path = write_pth(tmp_path / "a.pth", {"model": ARRAYS, "epoch": 3, "note": "text"})
    content = read_pickled(path)
    assert content["epoch"] == 3
    for name, array in ARRAYS.items():
        tensor = content["model"][name]
        assert tensor.shape == array.shape
        np.testing.assert_array_equal(tensor.read(), array)


def test_transposed_tensors_are_read_by_their_strides(tmp_path):
    path = write_pth(tmp_path / "a.pth", {"x": np.arange(9.0, dtype=np.float32).reshape(3, 3)})
    path = write_pth(path, {"x": ARRAYS["matrix"][:3, :3]}, strides=(1, 3))
    found = read_pickled(path)["x"].read()
    np.testing.assert_array_equal(found, ARRAYS["matrix"][:3, :3].T)


@pytest.mark.parametrize(
    ("module", "name", "arguments"),
    [
        ("os", "system", ("touch ran",)),
        ("builtins", "exec", ("open('ran', 'w')",)),
        ("builtins", "getattr", ("x", "y")),
        ("torch._utils", "_rebuild_wrapper_subclass", ()),
        ("collections", "namedtuple", ("a", "b")),
        ("argparse", "Namespace", ()),
    ],
)
def test_a_pickle_that_calls_anything_is_refused_and_runs_nothing(
    tmp_path, monkeypatch, module, name, arguments
):
    monkeypatch.chdir(tmp_path)
    bomb = call_of(module, name, *arguments)
    path = write_pth(tmp_path / "evil.pth", {**ARRAYS, "bomb": bomb})
    told = refusal(path)
    assert f"asks for '{module}.{name}' to be run" in told
    assert "nothing was run" in told
    assert os.listdir(tmp_path) == ["evil.pth"]


def test_the_bomb_of_this_test_does_go_off_without_care(tmp_path, monkeypatch):
    """Else the test above would prove nothing."""
    monkeypatch.chdir(tmp_path)
    path = write_pth(tmp_path / "evil.pth", {"bomb": call_of("os", "mkdir", "ran")})
    with zipfile.ZipFile(path) as archive:
        pickle.loads(archive.read("archive/data.pkl"))
    assert (tmp_path / "ran").is_dir()


def replace_pickle(path: Path, data: bytes, method: int = zipfile.ZIP_STORED) -> Path:
    with zipfile.ZipFile(path) as archive:
        entries = {name: archive.read(name) for name in archive.namelist()}
    with zipfile.ZipFile(path, "w", method) as archive:
        for name, kept in entries.items():
            archive.writestr(name, data if name.endswith("data.pkl") else kept)
    return path


@pytest.mark.parametrize("end", [b".", pickle.SETITEM + b"."], ids=["dictionary", "tensor"])
def test_attributes_that_a_pickle_sets_are_not_taken(tmp_path, end):
    path = write_pth(tmp_path / "a.pth", {"x": ARRAYS["matrix"]})
    with zipfile.ZipFile(path) as archive:
        data = archive.read("archive/data.pkl")
    place = data.rindex(end)
    overwrites = pickle.dumps({"items": 5, "read": 5}, protocol=0)[:-1] + pickle.BUILD
    replace_pickle(path, data[:place] + overwrites + data[place:])
    found = open_source(path).tensors
    np.testing.assert_array_equal(found["x"].read(), ARRAYS["matrix"])


def test_a_dictionary_that_holds_itself_is_refused(tmp_path):
    held: dict = {}
    held["itself"] = held
    path = replace_pickle(write_pth(tmp_path / "a.pth", ARRAYS), pickle.dumps(held, protocol=2))
    with pytest.raises(WeightsError, match="no dictionary of tensors: maximum recursion depth"):
        open_source(path)


def test_a_bomb_is_refused_before_it_is_unpacked(tmp_path):
    path = replace_pickle(write_pth(tmp_path / "a.pth", {}), bytes(64 << 20), zipfile.ZIP_DEFLATED)
    tracemalloc.start()
    told = refusal(path)
    assert tracemalloc.get_traced_memory()[1] < 8 << 20
    tracemalloc.stop()
    with pytest.raises(WeightsError) as caught:
        open_source(path)
    assert str(caught.value) == told
    assert told.startswith(f"'{path}' is compressed")


def test_a_file_that_cannot_be_what_it_says(tmp_path):
    path = write_pth(tmp_path / "a.pth", ARRAYS)
    path.write_bytes(path.read_bytes()[:-100])
    assert "damaged or cut short" in refusal(path)
    for strides in ((4, 100), (-1, 1)):
        path = write_pth(path, {"x": ARRAYS["matrix"]}, strides=strides)
        assert "reaches beyond" in refusal(path)
    assert "byte order" in refusal(write_pth(path, ARRAYS, byteorder="big"))


@pytest.mark.parametrize(
    ("content", "told"),
    [
        (b"", "no PyTorch file"),
        (b"<html>404</html>", "no PyTorch file: it begins with b'<htm'"),
        (b"PK\x03\x04" + bytes(50), "damaged or cut short"),
    ],
)
def test_no_weight_file_at_all(tmp_path, content, told):
    path = tmp_path / "a.pth"
    path.write_bytes(content)
    assert told in refusal(path)


def test_old_file_without_pytorch_says_what_to_install(tmp_path, monkeypatch):
    path = tmp_path / "a.pth"
    path.write_bytes(pickle.dumps({"a": 1}, protocol=2))
    real = builtins.__import__

    def without_torch(name, *args, **kwargs):
        if name == "torch":
            raise ImportError(name)
        return real(name, *args, **kwargs)

    monkeypatch.setattr(builtins, "__import__", without_torch)
    assert "pip install 'remind-jax[convert]'" in refusal(path)


@settings(
    max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(position=st.integers(0, 10_000), value=st.integers(0, 255))
def test_any_changed_byte_is_harmless(tmp_path, position, value):
    """It is refused, or changes nothing that is read."""
    path = write_pth(tmp_path / "a.pth", {"matrix": ARRAYS["matrix"]})
    data = bytearray(path.read_bytes())
    data[position % len(data)] = value
    path.write_bytes(data)
    try:
        arrays = read_everything(path)
    except WeightsError:
        return
    for array in arrays.values():
        np.testing.assert_array_equal(array, ARRAYS["matrix"])
