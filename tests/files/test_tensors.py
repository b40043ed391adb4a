"""Sizes that a file claims are compared before any array is read."""

from __future__ import annotations

import json
import struct
import zipfile

import numpy as np
import pytest
from safetensors.numpy import save_file

from remind_jax.errors import WeightsError
from remind_jax.files.tensors import read_npz, read_safetensors_header


@pytest.fixture
def stored(tmp_path):
    path = tmp_path / "a.safetensors"
    arrays = {
        "a": np.zeros((2, 3), np.float32),
        "empty": np.zeros((0, 4)),
        "b": np.zeros(5, np.int8),
    }
    save_file(arrays, path, metadata={"format": "ours"})
    return path


def test_a_header_is_read(stored):
    header = read_safetensors_header(stored, refused=WeightsError)
    assert header.metadata == {"format": "ours"}
    assert {name: entry.shape for name, entry in header.tensors.items()} == {
        "a": (2, 3),
        "empty": (0, 4),
        "b": (5,),
    }


def _with(path, **changes):
    """The same file with a tensor described otherwise."""
    data = path.read_bytes()
    (length,) = struct.unpack("<Q", data[:8])
    header = json.loads(data[8 : 8 + length])
    header["a"].update(changes)
    text = json.dumps(header).encode()
    path.write_bytes(struct.pack("<Q", len(text)) + text + data[8 + length :])


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"shape": [10**12]}, r"'a': shape \[1000000000000\] of F32 does not make 24 bytes"),
        ({"shape": [-1, 6]}, "found -1, allowed is an integer from 0"),
        ({"dtype": "O"}, "found dtype 'O'; allowed: BOOL"),
        ({"data_offsets": [0, 2**60]}, "allowed is an integer from 0"),
        ({"data_offsets": [24, 48]}, "its tensors overlap or leave gaps"),
        ({"shape": "2"}, 'found "2", allowed is a list'),
    ],
)
def test_a_header_that_lies_is_refused(stored, changes, said):
    _with(stored, **changes)
    with pytest.raises(WeightsError, match=said):
        read_safetensors_header(stored, refused=WeightsError)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda data: data[:-1], "cut short or damaged: it holds 28 bytes"),
        (lambda data: data + b"x", "holds 30 bytes of tensors, its header names 29"),
        (lambda data: struct.pack("<Q", 2**62) + data[8:], "its header would have"),
        (lambda data: data[:4], "its header would have"),
        (lambda data: b"", "its header would have 0 bytes"),
    ],
)
def test_a_file_of_another_size_is_refused(stored, change, said):
    stored.write_bytes(change(stored.read_bytes()))
    with pytest.raises(WeightsError, match=said):
        read_safetensors_header(stored, refused=WeightsError)


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
        assert list(read_npz(tmp_path / "a.npz", refused=WeightsError, names=("b",))) == ["b"]


def test_a_bomb_is_refused_before_it_is_read(tmp_path):
    np.savez_compressed(tmp_path / "a.npz", a=np.zeros(10**7))
    with pytest.raises(WeightsError, match=r"holds over 9\.537 MiB of arrays"):
        read_npz(tmp_path / "a.npz", refused=WeightsError, most_bytes=10**7)


def test_objects_are_never_read(tmp_path):
    np.savez(tmp_path / "a.npz", a=np.array([{"x": 1}], object))
    with pytest.raises(WeightsError, match="'a' holds Python objects, which are not read"):
        read_npz(tmp_path / "a.npz", refused=WeightsError)


def test_a_member_that_lies_is_refused(tmp_path):
    np.save(tmp_path / "a.npy", np.zeros(4))
    data = (tmp_path / "a.npy").read_bytes().replace(b"(4,)", b"(9,)")
    with zipfile.ZipFile(tmp_path / "a.npz", "w") as archive:
        archive.writestr("a.npy", data)
    with pytest.raises(
        WeightsError, match=r"'a' is damaged: shape \[9\] of float64 makes 72 bytes"
    ):
        read_npz(tmp_path / "a.npz", refused=WeightsError)


HEADERS = (
    "{'descr': '|u1', 'fortran_order': False, 'shape': (True, 3)}",
    "{'descr': '|u1', 'fortran_order': False, 'shape': (3.0,)}",
    "-" * 9000 + "1",
    "(" * 4000 + ")" * 4000,
    "{'descr': ('|u1', (100000, 100000)), 'fortran_order': False, 'shape': (3,)}",
)


@pytest.mark.parametrize("header", HEADERS, ids=range(len(HEADERS)))
def test_a_header_that_is_none_is_refused(tmp_path, header):
    length = len(header).to_bytes(2, "little")
    with zipfile.ZipFile(tmp_path / "a.npz", "w") as archive:
        archive.writestr("a.npy", b"\x93NUMPY\x01\x00" + length + header.encode() + bytes(3))
    with pytest.raises(WeightsError, match="is damaged or no NPZ file"):
        read_npz(tmp_path / "a.npz", refused=WeightsError)


@pytest.mark.parametrize("content", [b"", b"PK\x03\x04 no archive", b"\x93NUMPY"])
def test_no_archive_is_refused(tmp_path, content):
    (tmp_path / "a.npz").write_bytes(content)
    with pytest.raises(WeightsError, match="is damaged or no NPZ file"):
        read_npz(tmp_path / "a.npz", refused=WeightsError)
