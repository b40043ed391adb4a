"""Reads `.pth` files, whose pickles may name only what a dictionary of tensors needs.

Files older than PyTorch 1.6 are left to `torch.load(weights_only=True)`.
"""

from __future__ import annotations

import contextlib
import dataclasses
import io
import pickle
import zipfile
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import ml_dtypes
import numpy as np

from remind_jax.errors import WeightsError, first_line

_STORAGE_TYPES: dict[str, Any] = {
    "DoubleStorage": np.float64,
    "FloatStorage": np.float32,
    "HalfStorage": np.float16,
    "BFloat16Storage": ml_dtypes.bfloat16,
    "LongStorage": np.int64,
    "IntStorage": np.int32,
    "ShortStorage": np.int16,
    "CharStorage": np.int8,
    "ByteStorage": np.uint8,
    "BoolStorage": np.bool_,
}


class _Inert:
    """What a pickle builds; attributes that it wants to set on it are not taken."""

    def __setstate__(self, state: Any) -> None:
        del state  # such as `_metadata` of a state dictionary


class _Dictionary(_Inert, dict):
    """Stands for `collections.OrderedDict`."""


@dataclasses.dataclass(frozen=True)
class StorageType(_Inert):
    """Stands for a class such as `torch.FloatStorage`."""

    dtype: np.dtype


@dataclasses.dataclass(frozen=True)
class Storage(_Inert):
    """A run of numbers in the archive."""

    path: Path
    entry: str
    dtype: np.dtype
    num: int

    def read(self) -> np.ndarray:
        """The numbers, flat."""
        numbers = np.frombuffer(_read(self.path, self.entry), self.dtype)
        if len(numbers) != self.num:
            raise ValueError(f"{len(numbers)} numbers instead of {self.num}")
        return numbers


@dataclasses.dataclass(frozen=True)
class PickledTensor(_Inert):
    """Which numbers of a storage make up a tensor."""

    storage: Storage
    offset: int  # elements
    shape: tuple[int, ...]
    strides: tuple[int, ...]  # elements

    def read(self) -> np.ndarray:
        """The tensor. Raises WeightsError if it ends beyond its storage, or the file is damaged."""
        with _reading(self.storage.path, self.storage.entry):
            numbers = self.storage.read()[self.offset :]
            last = sum((n - 1) * step for n, step in zip(self.shape, self.strides, strict=True))
            is_beyond = 0 not in self.shape and last >= len(numbers)
            if is_beyond or min((self.offset, *self.shape, *self.strides)) < 0:
                raise ValueError(f"a tensor of shape {self.shape} reaches beyond it")
            steps = [step * numbers.itemsize for step in self.strides]
            return np.lib.stride_tricks.as_strided(numbers, self.shape, steps, writeable=False)


def read_pickled(path: Path) -> Mapping[str, Any]:
    """What a `.pth` file holds: tensors, and mappings, numbers and texts of a checkpoint.

    Tensors are `PickledTensor`s, in files that PyTorch itself has read its own.

    Raises:
      WeightsError: If it is damaged, cut short, no such file, or asks for anything but tensors.
    """
    with path.open("rb") as file:
        start = file.read(4)
    with _reading(path):
        content = _load(path) if start.startswith(b"PK") else _load_with_torch(path, start)
    if not isinstance(content, Mapping):
        raise WeightsError(
            f"'{path}' holds a {type(content).__name__} instead of a dictionary of tensors"
        )
    return content


@contextlib.contextmanager
def _reading(path: Path, entry: str = "") -> Iterator[None]:
    """Whatever fails, as anything can in a damaged archive or pickle, is told in one sentence."""
    try:
        yield
    except WeightsError:
        raise
    except Exception as error:
        place = f", '{entry}'," if entry else ""
        raise WeightsError(
            f"'{path}'{place} is damaged or cut short ({first_line(error)}); download it again"
        ) from error


def _read(path: Path, entry: str) -> bytes:
    """The bytes of an entry, checked against their sum; no more than the file has."""
    with zipfile.ZipFile(path) as archive:
        if archive.getinfo(entry).compress_type != zipfile.ZIP_STORED:
            raise WeightsError(
                f"'{path}' is compressed, as torch.save leaves no file; download it again from its "
                "publisher"
            )
        return archive.read(entry)


def _load(path: Path) -> Any:
    with zipfile.ZipFile(path) as archive:
        names = archive.namelist()
    pickles = [name for name in names if name.endswith("/data.pkl")]
    if len(pickles) != 1:
        raise WeightsError(
            f"'{path}' is a zip archive without tensors; give a file that torch.save has written, "
            "not a TorchScript or NumPy file"
        )
    root = pickles[0].removesuffix("data.pkl")
    order = _read(path, f"{root}byteorder") if f"{root}byteorder" in names else b"little"
    if order != b"little":
        raise WeightsError(f"'{path}' was written by a machine of byte order {order!r}")
    return _TensorUnpickler(io.BytesIO(_read(path, pickles[0])), path, root).load()


class _TensorUnpickler(pickle.Unpickler):
    """Builds dictionaries of `PickledTensor`s and refuses everything else."""

    def __init__(self, file: Any, path: Path, root: str) -> None:
        super().__init__(file, encoding="utf-8")
        self._path, self._root = path, root

    def find_class(self, module: str, name: str) -> Any:
        """The stand-in of a name."""
        if (module, name) == ("collections", "OrderedDict"):
            return _Dictionary
        if module == "torch._utils" and name in _REBUILD:
            return _REBUILD[name]
        if module == "torch" and name in _STORAGE_TYPES:
            return StorageType(np.dtype(_STORAGE_TYPES[name]))
        raise WeightsError(
            f"'{self._path}' asks for '{module}.{name}' to be run, which weights do not need; "
            "nothing was run: do not trust this file, download it from its publisher"
        )

    def persistent_load(self, pid: Any) -> Storage:
        """A storage by what the pickle says of it: kind, type, entry, device, size."""
        kind, storage_type, key, _, num = pid
        if kind != "storage" or not isinstance(storage_type, StorageType):
            raise pickle.UnpicklingError(f"unknown reference {kind!r}")
        return Storage(self._path, f"{self._root}data/{key}", storage_type.dtype, int(num))


def _rebuild_tensor(
    storage: Storage, offset: int, shape: tuple[int, ...], strides: tuple[int, ...], *rest: Any
) -> PickledTensor:
    del rest  # gradients and hooks
    if not isinstance(storage, Storage) or len(shape) != len(strides):
        raise pickle.UnpicklingError("a tensor without storage")
    return PickledTensor(storage, int(offset), tuple(map(int, shape)), tuple(map(int, strides)))


_REBUILD = {
    "_rebuild_tensor": _rebuild_tensor,
    "_rebuild_tensor_v2": _rebuild_tensor,
    "_rebuild_parameter": lambda tensor, *rest: tensor,
}


def _load_with_torch(path: Path, start: bytes) -> Any:
    """Files of PyTorch before 1.6, which are pickles one after another."""
    if not start.startswith(b"\x80"):
        raise WeightsError(
            f"'{path}' is damaged or no PyTorch file: it begins with {start!r}; download it again"
        )
    try:
        import torch  # pyright: ignore[reportMissingImports]
    except ImportError as error:
        raise WeightsError(
            f"'{path}' was written by a PyTorch before 1.6 or is no weight file; to read it, "
            "install PyTorch: pip install 'remind-jax[convert]'"
        ) from error
    return torch.load(path, map_location="cpu", weights_only=True)
