"""Sizes that a file claims are compared before any array is read."""

import json
import struct
import zipfile

import numpy as np
import pytest
from safetensors.numpy import save_file

from remind_jax.errors import WeightsError
from remind_jax.files import limits
from remind_jax.files.tensors import read_npz, read_safetensors_header, read_safetensors_parts


@pytest.fixture
def stored(tmp_path):
    path = tmp_path / "a.safetensors"
    arrays = {"a": np.zeros((2, 3), np.float32), "empty": np.zeros((0, 4)), "b": np.zeros(5, "i1")}
    save_file(arrays, path, metadata={"format": "ours"})
    return path


def test_a_header_is_read(stored):
    header = read_safetensors_header(stored, refused=WeightsError)
    assert header.metadata == {"format": "ours"}
    assert header.shapes == {"a": (2, 3), "empty": (0, 4), "b": (5,)}


def test_a_header_that_lies_is_refused(stored):
    data = stored.read_bytes()
    (length,) = struct.unpack("<Q", data[:8])
    files = [data[:-1], data + b"x", struct.pack("<Q", 2**62) + data[8:], data[:4], b""]
    for changes in (
        *({"shape": [10**12]}, {"shape": [-1, 6]}, {"dtype": "O"}, {"shape": "2"}),
        *({"data_offsets": [0, 2**60]}, {"data_offsets": [24, 48]}),
    ):
        header = json.loads(data[8 : 8 + length])
        header["a"].update(changes)
        text = json.dumps(header).encode()
        files.append(struct.pack("<Q", len(text)) + text + data[8 + length :])
    for content in files:
        stored.write_bytes(content)
        with pytest.raises(WeightsError, match=r"a\.safetensors"):
            read_safetensors_header(stored, refused=WeightsError)


def test_parts_are_read_one_after_another(stored):
    data = stored.read_bytes()
    for num, end in ((1, b""), (3, b""), (2, b"\0" * 9), (2, data[:-1]), (1, data[:30]), (2, b"{")):
        stored.write_bytes(num * data + end)
        parts, is_whole = read_safetensors_parts(stored, refused=WeightsError)
        assert (len(parts), is_whole) == (num, not end)
        for part in parts:
            assert part.metadata == {"format": "ours"}
            assert {name: one.shape for name, one in part.tensors.items()} == {
                "a": (2, 3), "empty": (0, 4), "b": (5,)
            }  # fmt: skip
    for content in (b"", data[:-1], b"\0" * 9, data[:4]):
        stored.write_bytes(content)
        with pytest.raises(WeightsError, match=r"a\.safetensors"):
            read_safetensors_parts(stored, refused=WeightsError)


def test_arrays_are_read_back(tmp_path):
    arrays = {
        "a": np.arange(6).reshape(2, 3),
        "b": np.array(["mug"]),
        "f": np.asfortranarray(np.eye(3)),
    }
    for save in (np.savez, np.savez_compressed):
        save(tmp_path / "a.npz", **arrays)
        found = read_npz(tmp_path / "a.npz", refused=WeightsError)
        assert found.keys() == arrays.keys()
        for name, array in arrays.items():
            np.testing.assert_array_equal(found[name], array)


def test_a_bomb_is_refused_before_it_is_read(tmp_path, monkeypatch):
    monkeypatch.setattr(limits, "MAX_NPZ_BYTES", 10**7)
    np.savez_compressed(tmp_path / "a.npz", a=np.zeros(10**7))
    with pytest.raises(WeightsError, match=r"holds over 9\.537 MiB of arrays"):
        read_npz(tmp_path / "a.npz", refused=WeightsError)


def test_what_is_no_sound_archive_is_refused(tmp_path):
    path = tmp_path / "a.npz"
    np.savez(path, a=np.array([{"x": 1}], object))
    contents = [path.read_bytes(), b"", b"PK\x03\x04 no archive", b"\x93NUMPY"]
    np.save(tmp_path / "a.npy", np.zeros(4))
    members = [(tmp_path / "a.npy").read_bytes().replace(b"(4,)", b"(9,)")]
    for header in (
        "{'descr': '|u1', 'fortran_order': False, 'shape': (True, 3)}",
        "{'descr': '|u1', 'fortran_order': False, 'shape': (3.0,)}",
        "{'descr': '|u1', 'fortran_order': False, 'shape': (1000000000000,)}",
        "-" * 9000 + "1",
        "(" * 4000 + ")" * 4000,
        "{'descr': ('|u1', (100000, 100000)), 'fortran_order': False, 'shape': (3,)}",
    ):
        length = len(header).to_bytes(2, "little")
        members.append(b"\x93NUMPY\x01\x00" + length + header.encode() + bytes(3))
    for member in members:
        with zipfile.ZipFile(path, "w") as archive:
            archive.writestr("a.npy", member)
        contents.append(path.read_bytes())
    for content in contents:
        path.write_bytes(content)
        with pytest.raises(WeightsError, match=r"a\.npz"):
            read_npz(path, refused=WeightsError)
