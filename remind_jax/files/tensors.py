"""Arrays in files: what a file says of their sizes is compared before any of them is read."""

from __future__ import annotations

import math
import zipfile
import zlib
from collections.abc import Collection
from pathlib import Path
from typing import Annotated, Any

import msgspec
import numpy as np
from msgspec import Meta

from remind_jax.errors import RemindError, first_line
from remind_jax.files import reading
from remind_jax.files.records import decode_json

MOST_TENSOR_BYTES = 64 << 30  # of a file of weights or a memory, which is as large as its arrays
MOST_NPZ_BYTES = 1 << 30  # of all members together, as they are in memory
MOST_RATIO = 20  # or so often the bytes of the file, where that is more
MOST_MEMBERS = 10_000
MOST_DIMENSIONS = 32
_MOST_HEADER_BYTES = 64 << 20
_BITS = {
    "BOOL": 8,
    **{f"{sign}{bits}": bits for sign in "IU" for bits in (8, 16, 32, 64)},
    **{"F16": 16, "BF16": 16, "F32": 32, "F64": 64, "C64": 64},
    **{"F8_E4M3": 8, "F8_E5M2": 8, "F8_E8M0": 8},
}
_Size = Annotated[int, Meta(ge=0, le=2**48)]


class TensorEntry(msgspec.Struct, frozen=True):
    """What a header says of one tensor."""

    dtype: Annotated[str, Meta(max_length=20)]
    shape: Annotated[tuple[_Size, ...], Meta(max_length=MOST_DIMENSIONS)]
    data_offsets: tuple[_Size, _Size]  # bytes after the header


class SafetensorsHeader(msgspec.Struct, frozen=True):
    """What a safetensors file says of itself, checked against its size."""

    metadata: dict[str, str]
    tensors: dict[str, TensorEntry]


def read_safetensors_header(
    path: str | Path,
    *,
    refused: type[RemindError],
    most_bytes: int = MOST_TENSOR_BYTES,
) -> SafetensorsHeader:
    """Reads the header of a safetensors file, and nothing else.

    Raises:
      RemindError: Of kind `refused`, if the file cannot be read or is too large, the header is
        damaged, or its tensors do not fill the rest of the file exactly.
    """
    where = f"'{path}'"
    try:
        reading.check_regular(path)
        reading.check_size(path, most_bytes)
        with Path(path).open("rb") as file:
            size = file.seek(0, 2)
            file.seek(0)
            length = int.from_bytes(file.read(8), "little")
            if not 0 < length <= min(_MOST_HEADER_BYTES, size - 8):
                raise refused(
                    f"{where} is cut short, damaged or no safetensors file: its header would have "
                    f"{length} bytes, the file has {size}"
                )
            data = file.read(length)
    except OSError as error:
        raise refused(f"cannot read {where}: {error.strerror or first_line(error)}") from error
    parts = decode_json(data, dict[str, msgspec.Raw], f"{where}, header", refused=refused)
    metadata: dict[str, str] = {}
    tensors: dict[str, TensorEntry] = {}
    for name, raw in parts.items():
        place = f"{where}, header, {name[:100]!r}"
        if name == "__metadata__":
            metadata = decode_json(bytes(raw), dict[str, str], place, refused=refused)
        else:
            tensors[name] = decode_json(bytes(raw), TensorEntry, place, refused=refused)
            _check_entry(tensors[name], place, refused)
    ends = [0]
    for entry in sorted(tensors.values(), key=lambda entry: entry.data_offsets):
        if entry.data_offsets[0] != ends[-1]:
            raise refused(f"{where} is damaged: its tensors overlap or leave gaps; make it again")
        ends.append(entry.data_offsets[1])
    if ends[-1] != size - 8 - length:
        raise refused(
            f"{where} is cut short or damaged: it holds {size - 8 - length} bytes of tensors, its "
            f"header names {ends[-1]}; make it again"
        )
    return SafetensorsHeader(metadata, tensors)


def _check_entry(entry: TensorEntry, place: str, refused: type[RemindError]) -> None:
    """Whether type and shape make as many bytes as the entry has."""
    bits = _BITS.get(entry.dtype)
    if bits is None:
        raise refused(f"{place}: found dtype {entry.dtype!r}; allowed: {', '.join(_BITS)}")
    start, end = entry.data_offsets
    if math.prod(entry.shape) * bits != 8 * (end - start):
        raise refused(
            f"{place}: shape {list(entry.shape)} of {entry.dtype} does not make {end - start} "
            "bytes; the file is damaged, make it again"
        )


def read_npz(
    path: str | Path,
    *,
    refused: type[RemindError],
    names: Collection[str] | None = None,
    most_bytes: int = MOST_NPZ_BYTES,
) -> dict[str, np.ndarray]:
    """Reads arrays of an NPZ file; their types and sizes are compared before any is decompressed.

    Args:
      path: The file.
      refused: Kind of error.
      names: Only arrays of these names are read; all if left out.
      most_bytes: Of the arrays together in memory, or `MOST_RATIO` times the size of the file.

    Raises:
      RemindError: Of kind `refused`, if the file cannot be read, is no NPZ file, is damaged, holds
        Python objects, or more than `most_bytes`.
    """
    where = f"'{path}'"
    try:
        reading.check_regular(path)
        most_bytes = max(most_bytes, MOST_RATIO * Path(path).stat().st_size)
        with Path(path).open("rb") as stream, zipfile.ZipFile(stream) as archive:
            members = _check_members(archive, where, refused, most_bytes, names)
            return {name: _read_member(archive, info) for name, info in members.items()}
    except OSError as error:
        raise refused(f"cannot read {where}: {error.strerror or first_line(error)}") from error
    except (zipfile.BadZipFile, zipfile.LargeZipFile, ValueError, EOFError) as error:
        if isinstance(error, RemindError):
            raise
        raise refused(f"{where} is damaged or no NPZ file ({first_line(error)})") from error
    except (NotImplementedError, RuntimeError, zlib.error) as error:
        raise refused(f"{where} cannot be decompressed ({first_line(error)})") from error


def _check_members(
    archive: zipfile.ZipFile,
    where: str,
    refused: type[RemindError],
    most_bytes: int,
    names: Collection[str] | None,
) -> dict[str, zipfile.ZipInfo]:
    """The members to read, by name of their array."""
    infos = archive.infolist()
    if len(infos) > MOST_MEMBERS:
        raise refused(f"{where} has {len(infos)} members; at most {MOST_MEMBERS} are read")
    members: dict[str, zipfile.ZipInfo] = {}
    total = 0
    for info in infos:
        name = info.filename.removesuffix(".npy")
        if names is not None and name not in names:
            continue
        if name in members:
            raise refused(f"{where} has two arrays '{name}'; make it again")
        shape, dtype, start = _member_header(archive, info)
        if dtype.hasobject:
            raise refused(f"{where}: '{name}' holds Python objects, which are not read")
        size = math.prod(shape) * dtype.itemsize
        if start + size != info.file_size:
            raise refused(
                f"{where}: '{name}' is damaged: shape {list(shape)} of {dtype} makes {size} bytes, "
                f"it has {info.file_size - start}; make the file again"
            )
        total += size
        if total > most_bytes:
            most = reading.say_bytes(most_bytes)
            raise refused(f"{where} holds over {most} of arrays, which are not read; split it")
        members[name] = info
    return members


def _member_header(
    archive: zipfile.ZipFile, info: zipfile.ZipInfo
) -> tuple[tuple[int, ...], np.dtype[Any], int]:
    """Shape and type of an array, and where its values begin in the member, in bytes."""
    with archive.open(info) as file:
        version = np.lib.format.read_magic(file)
        if version not in ((1, 0), (2, 0), (3, 0)):
            raise ValueError(f"an array has version {version} of the format")
        read = np.lib.format.read_array_header_1_0 if version == (1, 0) else _read_long_header
        try:
            shape, _, dtype = read(file)
        except (ArithmeticError, MemoryError, RecursionError, SyntaxError, TypeError) as error:
            raise ValueError("the header of an array is damaged") from error
        # True is a whole number to Python.
        if any(type(side) is not int or side < 0 for side in shape) or len(shape) > MOST_DIMENSIONS:
            raise ValueError(f"an array has shape {shape}")
        return shape, dtype, file.tell()


def _read_long_header(file: Any) -> tuple[tuple[int, ...], bool, np.dtype[Any]]:
    return np.lib.format.read_array_header_2_0(file)


def _read_member(archive: zipfile.ZipFile, info: zipfile.ZipInfo) -> np.ndarray:
    with archive.open(info) as file:
        return np.lib.format.read_array(file, allow_pickle=False)
