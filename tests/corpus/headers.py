"""Headers of binary files made to claim what is not so: pictures, videos, arrays, networks."""

import dataclasses
import random
import struct
import zlib
from pathlib import Path

_SIDES = (0, 1, 2, 3, 255, 8193, 20_000, 60_000, 65_535)
_WORDS = (*_SIDES, 2**31 - 1, 2**31, 2**32 - 1)
_HEADER_BYTES = 1024  # headers lie in the first so many, or the last


@dataclasses.dataclass(frozen=True)
class Change:
    """What was done to a file."""

    name: str
    is_invalid: bool  # nothing that reads this may take it for good


def change_header(path: Path, rng: random.Random) -> Change:
    """Changes numbers of a header, keeping checksums right where the format has them."""
    data = bytearray(path.read_bytes())
    if data.startswith(b"\x89PNG"):
        change = _change_png(data, rng)
    elif data.startswith(b"\xff\xd8"):
        change = _change_jpeg(data, rng)
    elif data.startswith(b"\x93NUMPY"):
        change = _change_npy(data, rng)
    else:
        change = _change_word(data, rng)
    path.write_bytes(data)
    return change


def _change_png(data: bytearray, rng: random.Random) -> Change:
    kind = rng.choice(("size", "depth", "chunk length", "chunk dropped", "no end"))
    end = 33  # of the first chunk
    if kind == "size":
        sides = rng.choice(_WORDS), rng.choice(_WORDS)
        data[16:24] = struct.pack(">II", *sides)
    elif kind == "depth":
        data[24:26] = bytes((rng.choice((0, 1, 2, 3, 4, 8, 16, 255)), rng.randrange(8)))
    elif kind == "chunk length":
        data[end : end + 4] = struct.pack(">I", rng.choice(_WORDS))
    elif kind == "chunk dropped":
        (length,) = struct.unpack_from(">I", data, end)
        del data[end : end + 12 + length]
    else:
        del data[-12:]
    data[29:33] = struct.pack(">I", zlib.crc32(data[12:29]))
    return Change(f"PNG: {kind}", False)


def _change_jpeg(data: bytearray, rng: random.Random) -> Change:
    at = next((i for i in range(len(data) - 1) if data[i] == 0xFF and data[i + 1] in (192, 194)), 0)
    if at and rng.random() < 0.6:
        struct.pack_into(">HH", data, at + 5, rng.choice(_SIDES), rng.choice(_SIDES))
        return Change("JPEG: size", False)
    return _change_word(data, rng)


def _change_npy(data: bytearray, rng: random.Random) -> Change:
    (length,) = struct.unpack_from("<H", data, 8)
    shape = rng.choice(
        ("(10**9,)", "(-1, 2)", "(1099511627776, 1099511627776)", "(1.5,)", "()", "(True,)")
    )
    descr = rng.choice(("<f4", "|O", "<U100000000", "|V8", "<f16", "x"))
    header = f"{{'descr': '{descr}', 'fortran_order': False, 'shape': {shape}, }}"
    data[10 : 10 + length] = header.ljust(length - 1)[: length - 1].encode() + b"\n"
    return Change(f"NPY: {descr} {shape}", descr == "|O")


def _change_word(data: bytearray, rng: random.Random) -> Change:
    """A number of two or four bytes in the header becomes another one."""
    if len(data) < 8:
        return Change("nothing to change", False)
    at = rng.randrange(min(len(data) - 4, _HEADER_BYTES))
    if rng.random() < 0.3:
        at = len(data) - 4 - at
    code = rng.choice(("<H", ">H", "<I", ">I"))
    word = rng.choice(_WORDS) % 256 ** struct.calcsize(code)
    struct.pack_into(code, data, at, word)
    return Change(f"{code} at {at} is {word}", False)
