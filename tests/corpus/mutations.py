"""Valid files made invalid, or only odd, by their structure; every change follows from a seed."""

import io
import json
import os
import random
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from tests.corpus.headers import Change, change_header

ODD_NUMBERS: tuple[Any, ...] = (0, -1, 1e12, -1e12, 2**63, 10**40, 0.5, -0.0, 1e-300)
NOT_FINITE = (float("nan"), float("inf"), -float("inf"))
ODD_TEXTS = (
    "",
    " ",
    "\x1b[31mred\x1b[0m",
    "a\nb\r\tc",
    "=1+1",
    "@SUM(A1)",
    "x" * 100_000,
    "../../etc/passwd",
    "\u202egnp.exe",
    "\x00",
    "NaN",
)
OTHER_KINDS: tuple[Any, ...] = (None, True, [], {}, "text", 3, [1, [2, [3]]], {"a": {"b": 1}})


def change_file(path: Path, kind: str, rng: random.Random) -> Change:
    """Changes a file in place, by its structure or by its bytes."""
    by_structure = {
        "json": _change_json,
        "jsonl": _change_lines_of_json,
        "yaml": _change_yaml,
        "text": _change_cells,
        "npz": _change_npz,
        "safetensors": _change_safetensors,
        "header": change_header,
    }
    if kind in by_structure and rng.random() < 0.75:
        return by_structure[kind](path, rng)
    return _change_bytes(path, rng)


def _change_json(path: Path, rng: random.Random) -> Change:
    content, change = change_tree(json.loads(path.read_text()), rng)
    path.write_text(json.dumps(content), encoding="utf-8", errors="surrogatepass")
    return change


def _change_lines_of_json(path: Path, rng: random.Random) -> Change:
    lines = path.read_text().splitlines()
    at = rng.randrange(len(lines))
    content, change = change_tree(json.loads(lines[at]), rng)
    lines[at] = json.dumps(content)
    path.write_text("\n".join(lines) + "\n")
    return change


def _change_yaml(path: Path, rng: random.Random) -> Change:
    if rng.random() < 0.1:
        bombs = ("a: &a [x, x]\nb: &b [*a, *a]\nc: [*b, *b]\n", "!!python/object:os.system {}\n")
        path.write_text(rng.choice(bombs))
        return Change("yaml with anchors or tags", False)
    content, change = change_tree(yaml.safe_load(path.read_text()), rng)
    path.write_text(yaml.safe_dump(content, allow_unicode=True))
    return change


def change_tree(content: Any, rng: random.Random) -> tuple[Any, Change]:
    """Changes one node of nested lists, mappings and values."""
    places: list[tuple[Any, Any]] = list(_places(content))
    if not places:
        return rng.choice(OTHER_KINDS), Change("the whole is another kind", True)
    holder, key = rng.choice(places)
    value = holder[key]
    name = rng.choice(_changes_of(value))
    if name == "another kind":
        holder[key] = rng.choice(OTHER_KINDS)
    elif name == "deep":
        nested: Any = 0
        for _ in range(300):
            nested = [nested]
        holder[key] = nested
    elif name == "removed":
        del holder[key]
    elif name == "odd number":
        holder[key] = rng.choice(ODD_NUMBERS)
    elif name == "not finite":
        holder[key] = rng.choice(NOT_FINITE)
    elif name == "odd text":
        holder[key] = rng.choice(ODD_TEXTS)
    elif name == "longer":
        holder[key] = value * 50 or [0] * 50
    elif name == "shorter":
        holder[key] = value[: len(value) // 2]
    else:
        value[rng.choice(ODD_TEXTS)] = rng.choice(OTHER_KINDS)
    return content, Change(f"{name} at {key!r}"[:80], name == "not finite")


def _changes_of(value: Any) -> list[str]:
    is_number = isinstance(value, (int, float)) and not isinstance(value, bool)
    options = ["another kind", "deep", "removed"]
    options += ["odd number", "not finite"] * 2 if is_number else []
    options += ["odd text"] * 3 if isinstance(value, str) else []
    options += ["longer", "shorter"] if isinstance(value, list) else []
    options += ["extra key"] if isinstance(value, dict) else []
    return options


def _places(content: Any) -> Iterator[tuple[Any, Any]]:
    if isinstance(content, dict):
        for key, value in content.items():
            yield content, key
            yield from _places(value)
    elif isinstance(content, list):
        for index, value in enumerate(content):
            yield content, index
            yield from _places(value)


def _change_cells(path: Path, rng: random.Random) -> Change:
    rows = [line.split(",") for line in path.read_text().splitlines()]
    row: list[str] = rng.choice(rows)
    column = rng.randrange(len(row))
    options = [*map(str, ODD_NUMBERS), *map(str, NOT_FINITE), *ODD_TEXTS]
    new = rng.choice(options)
    row[column] = new
    is_cut = rng.random() < 0.2
    if is_cut:
        del row[column:]
    path.write_text("\n".join(",".join(row) for row in rows) + "\n", encoding="utf-8")
    return Change(f"column {column} is {new[:20]!r}", not is_cut and new in map(str, NOT_FINITE))


def _change_npz(path: Path, rng: random.Random) -> Change:
    with np.load(path) as file:
        arrays: dict[str, np.ndarray] = {name: file[name] for name in file.files}
    name = rng.choice(list(arrays))
    array = arrays[name]
    kinds = ["removed", "other type", "other shape", "empty", "longer", "object"]
    kinds += ["not finite"] * 2 if array.dtype.kind == "f" else []
    kind = rng.choice(kinds)
    if kind == "removed":
        del arrays[name]
    elif kind == "other type":
        others = ["S8"] if array.dtype.kind == "U" else ["U8", "c8", "f8", "i1", "?"]
        arrays[name] = array.astype(rng.choice(others), casting="unsafe")
    elif kind == "other shape":
        arrays[name] = array.reshape(-1) if array.ndim > 1 else array[None]
    elif kind == "empty":
        arrays[name] = np.atleast_1d(array)[:0]
    elif kind == "longer":
        arrays[name] = np.concatenate([np.atleast_1d(array)] * 2)
    elif kind == "object":
        arrays[name] = np.array([{"a": 1}], object)
    else:
        arrays[name] = np.full_like(array, rng.choice(NOT_FINITE))
    buffer = io.BytesIO()
    np.savez(buffer, **arrays)
    path.write_bytes(buffer.getvalue())
    return Change(f"{kind}: {name}", kind == "object")


def _change_safetensors(path: Path, rng: random.Random) -> Change:
    data = path.read_bytes()
    (size,) = struct.unpack("<Q", data[:8])
    if rng.random() < 0.15:
        path.write_bytes(struct.pack("<Q", rng.choice((0, 2**62, size * 1000))) + data[8:])
        return Change("length of the header", True)
    header, body = json.loads(data[8 : 8 + size]), bytearray(data[8 + size :])
    if rng.random() < 0.4 and len(body) > 8:
        at = 4 * rng.randrange(len(body) // 4)
        body[at : at + 4] = struct.pack("<f", rng.choice(NOT_FINITE))
        change = Change("a value is not finite", False)  # where integers lie it is any number
    else:
        section = header["__metadata__"] if rng.random() < 0.5 else header
        key = rng.choice(list(section))
        if isinstance(section[key], str) and section[key].startswith(("{", "[")):
            content, change = change_tree(json.loads(section[key]), rng)
            section[key] = json.dumps(content)
        else:
            _, change = change_tree(section, rng)
    text = json.dumps(header).encode("utf-8", "surrogatepass")
    path.write_bytes(struct.pack("<Q", len(text)) + text + bytes(body))
    return change


def _change_bytes(path: Path, rng: random.Random) -> Change:
    data = bytearray(path.read_bytes())
    kind = rng.choice(
        (
            *("cut", "flipped", "empty", "UTF-16", "Latin-1", "byte order mark", "random"),
            *("a pipe", "a folder", "a device", "a broken link", "not readable as text"),
        )
    )
    if kind == "cut":
        path.write_bytes(data[: rng.randrange(len(data))])
    elif kind == "flipped":
        for _ in range(rng.choice((1, 8, 64))):
            data[rng.randrange(len(data))] ^= 1 << rng.randrange(8)
        path.write_bytes(data)
    elif kind == "empty":
        path.write_bytes(b"")
    elif kind == "UTF-16":
        path.write_bytes(bytes(data).decode("latin-1").encode("utf-16"))
    elif kind == "Latin-1":
        path.write_bytes(bytes(data).replace(b"cup", "caf\u00e9".encode("latin-1")))
    elif kind == "byte order mark":
        path.write_bytes(b"\xef\xbb\xbf" + data)
    elif kind == "random":
        path.write_bytes(rng.randbytes(len(data)))
    elif kind == "not readable as text":
        path.write_bytes(b"\xff\xfe\xfd" + data)
    else:
        path.unlink()
        if kind == "a pipe":
            os.mkfifo(path)
        elif kind == "a folder":
            path.mkdir()
        else:
            path.symlink_to("/dev/zero" if kind == "a device" else "/nowhere/at/all")
    return Change(kind, False)
