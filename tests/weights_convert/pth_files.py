"""Writes `.pth` files as PyTorch does, without PyTorch: a pickle and raw storages in a zip."""

import collections
import io
import pickle
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any, ClassVar

import numpy as np


class _Global:
    """Pickles as a reference to a name of a module that need not be there."""

    def __init__(self, module: str, name: str) -> None:
        self.module, self.name = module, name

    def __call__(self) -> None:  # pickle wants functions to be callable
        raise NotImplementedError


class _Storage:
    def __init__(self, key: str, array: np.ndarray) -> None:
        self.key, self.array = key, array


class _Tensor:
    def __init__(self, storage: _Storage, offset: int, shape: Any, strides: Any) -> None:
        self.parts = (storage, offset, tuple(shape), tuple(strides), False, _ORDERED)

    def __reduce__(self) -> Any:
        return _REBUILD, self.parts


class _OrderedDict:
    def __reduce__(self) -> Any:
        return collections.OrderedDict, ()


_REBUILD = _Global("torch._utils", "_rebuild_tensor_v2")
_ORDERED = _OrderedDict()
_STORAGES = {"float32": "FloatStorage", "float16": "HalfStorage", "int64": "LongStorage"}


_PurePickler: Any = pickle._Pickler  # the one written in Python can be taught new types


class _Pickler(_PurePickler):
    dispatch: ClassVar[Any] = dict(_PurePickler.dispatch)

    def save_global_reference(self, obj: _Global) -> None:
        self.write(pickle.GLOBAL + f"{obj.module}\n{obj.name}\n".encode())
        self.memoize(obj)

    dispatch[_Global] = save_global_reference

    def persistent_id(self, obj: Any) -> Any:
        if not isinstance(obj, _Storage):
            return None
        kind = _Global("torch", _STORAGES[obj.array.dtype.name])
        return "storage", kind, obj.key, "cpu", obj.array.size


def write_pth(path: Path, content: Any, **extra: Any) -> Path:
    """Writes a dictionary of arrays, nested where it is, as `torch.save` does."""
    storages: list[_Storage] = []

    def convert(value: Any) -> Any:
        if isinstance(value, Mapping):
            return collections.OrderedDict((key, convert(v)) for key, v in value.items())
        if isinstance(value, np.ndarray):
            storages.append(_Storage(str(len(storages)), np.asarray(value, order="C")))
            steps = [s // value.itemsize for s in storages[-1].array.strides]
            return _Tensor(storages[-1], 0, value.shape, extra.get("strides") or steps)
        return value

    stream = io.BytesIO()
    _Pickler(stream, protocol=2).dump(convert(content))
    with zipfile.ZipFile(path, "w", zipfile.ZIP_STORED) as archive:
        archive.writestr("archive/data.pkl", stream.getvalue())
        archive.writestr("archive/byteorder", extra.get("byteorder", "little"))
        for storage in storages:
            archive.writestr(f"archive/data/{storage.key}", storage.array.tobytes())
        archive.writestr("archive/version", "3\n")
    return path


def call_of(module: str, name: str, *arguments: Any) -> Any:
    """An object that, unpickled without care, calls a function."""

    class Bomb:
        def __reduce__(self) -> Any:
            return _Global(module, name), arguments

    return Bomb()
