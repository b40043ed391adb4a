"""Arrays in files: what a file says of their sizes is compared before any of them is read."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import IO, Annotated

import msgspec
import numpy as np

from remind_jax.files import limits
from remind_jax.files.reading import (
    Family,
    check_regular,
    check_size,
    read_bytes,
    reading,
    say_bytes,
)

_Offset = Annotated[int, msgspec.Meta(ge=0, le=limits.MAX_TENSOR_BYTES)]


@dataclasses.dataclass(frozen=True)
class SafetensorsHeader:
    """What a safetensors file says of itself; its library has checked it against its size."""

    metadata: dict[str, str]
    shapes: dict[str, tuple[int, ...]]  # of its tensors


def read_safetensors_header(path: str | Path, *, refused: Family) -> SafetensorsHeader:
    """Reads the header of a safetensors file, and nothing else.

    Raises:
      RemindError: Of kind `refused`, if the file cannot be read or is too large, the header is
        damaged, or its tensors do not fill the rest of the file exactly.
    """
    from safetensors import safe_open

    with reading(path, refused):
        check_regular(path)
        check_size(path, limits.MAX_TENSOR_BYTES)
        with safe_open(str(path), "np") as file:
            names = file.keys()
            shapes = {name: tuple(file.get_slice(name).get_shape()) for name in names}
            return SafetensorsHeader(dict(file.metadata() or {}), shapes)


@dataclasses.dataclass(frozen=True)
class SafetensorsPart:
    """What one of several safetensors in a file holds."""

    metadata: dict[str, str]
    tensors: dict[str, np.ndarray]


def read_safetensors_parts(
    path: str | Path, *, refused: Family
) -> tuple[list[SafetensorsPart], bool]:
    """Reads safetensors that lie in a file one after another; also says whether the last is whole.

    Where it is not, as after a kill while it was added, the parts before it are given.

    Raises:
      RemindError: Of kind `refused`, if the file cannot be read or is too large, or the first part
        is not whole.
    """
    from safetensors.numpy import load

    parts: list[SafetensorsPart] = []
    with reading(path, refused):
        data = read_bytes(path, limits.MAX_TENSOR_BYTES)
        start = 0
        while start < len(data) or not parts:
            header, end = _header_at(data, start)
            try:
                tensors = load(data if (start, end) == (0, len(data)) else data[start:end])
            except Exception:  # of somebody else's code
                if parts:
                    return parts, False
                raise
            metadata = msgspec.json.decode(header, type=_Description).metadata
            parts.append(SafetensorsPart(metadata, tensors))
            start = end
    return parts, True


class _Placed(msgspec.Struct):
    """Where a tensor lies; of the description, nowhere."""

    data_offsets: tuple[_Offset, _Offset] = (0, 0)


class _Description(msgspec.Struct):
    metadata: dict[str, str] = msgspec.field(name="__metadata__", default_factory=dict)


def _header_at(data: bytes, start: int) -> tuple[bytes, int]:
    """The header of safetensors in the middle of a file, and where they end as it says.

    That is the end of the file where it does not say so.
    """
    first = start + 8
    header = data[first : first + int.from_bytes(data[start:first], "little")]
    try:
        placed = msgspec.json.decode(header, type=dict[str, _Placed])
    except (msgspec.MsgspecError, UnicodeDecodeError, RecursionError):
        return header, len(data)
    last = max((one.data_offsets[1] for one in placed.values()), default=0)
    return header, first + len(header) + last


def read_npz(path: str | Path, *, refused: Family) -> dict[str, np.ndarray]:
    """Reads arrays of an NPZ file; their sizes are compared before any is decompressed.

    Raises:
      RemindError: Of kind `refused`, if the file cannot be read, is no NPZ file, is damaged, holds
        Python objects, or more than `MAX_NPZ_BYTES` and `MAX_NPZ_RATIO` times its own size.
    """
    arrays: dict[str, np.ndarray] = {}
    with reading(path, refused):
        check_regular(path)
        max_bytes = max(limits.MAX_NPZ_BYTES, limits.MAX_NPZ_RATIO * Path(path).stat().st_size)
        with zipfile.ZipFile(path) as archive:
            infos = {info.filename.removesuffix(".npy"): info for info in archive.infolist()}
            if len(archive.infolist()) > min(limits.MAX_MEMBERS, len(infos)):
                raise refused(
                    f"'{path}' has {len(archive.infolist())} members; at most {limits.MAX_MEMBERS} "
                    "of different names are read"
                )
            if sum(info.file_size for info in infos.values()) > max_bytes:
                raise refused(
                    f"'{path}' holds over {say_bytes(max_bytes)} of arrays, which are not read; "
                    "split it"
                )
            for name, info in infos.items():
                with reading(path, refused, place=repr(name)), archive.open(info) as file:
                    arrays[name] = _read_array(file, info.file_size)
    return arrays


def _read_array(file: IO[bytes], num_bytes: int) -> np.ndarray:
    """Reads an array that takes so many bytes with its header.

    NumPy takes memory for the shape that a header names before it reads.
    """
    formats = np.lib.format
    is_first = formats.read_magic(file) == (1, 0)
    read = formats.read_array_header_1_0 if is_first else formats.read_array_header_2_0
    shape, _, dtype = read(file)
    if file.tell() + int(np.prod(shape, dtype=object)) * dtype.itemsize != num_bytes:
        raise ValueError(f"shape {shape} of {dtype} does not fill it")
    file.seek(0)
    return formats.read_array(file, allow_pickle=False)


def checksum_of(metadata: Mapping[str, str], tensors: Mapping[str, np.ndarray]) -> str:
    """Of metadata and arrays of a file, in any order, but for a checksum among the metadata."""
    digest = hashlib.sha256()
    described = {name: value for name, value in metadata.items() if name != "sha256"}
    digest.update(json.dumps(described, sort_keys=True).encode("ascii"))
    for name in sorted(tensors):
        array = np.ascontiguousarray(tensors[name])
        digest.update(f"{name} {array.dtype.str} {array.shape}".encode())
        digest.update(array.data if array.size else b"")
    return digest.hexdigest()
