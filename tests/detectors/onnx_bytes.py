"""Tiny ONNX models written byte by byte, so that tests need neither `onnx` nor a real network."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

Shape = Sequence[int | str]  # a text stands for a size left open


def varint(value: int) -> bytes:
    out = bytearray()
    while value >= 0x80:
        out.append(value & 0x7F | 0x80)
        value >>= 7
    return bytes([*out, value])


def number(field: int, value: int) -> bytes:
    return varint(field << 3) + varint(value)


def text(field: int, value: str | bytes) -> bytes:
    data = value.encode() if isinstance(value, str) else value
    return varint(field << 3 | 2) + varint(len(data)) + data


def value_info(name: str, shape: Shape, dtype: int = 1) -> bytes:
    sizes = b"".join(
        text(1, text(2, size) if isinstance(size, str) else number(1, size)) for size in shape
    )
    return text(1, name) + text(2, text(1, number(1, dtype) + text(2, sizes)))


def constant(name: str, array: np.ndarray) -> bytes:
    dtype, code = ("<i8", 7) if array.dtype.kind == "i" else ("<f4", 1)
    sizes = b"".join(number(1, size) for size in array.shape)
    return sizes + number(2, code) + text(8, name) + text(9, array.astype(dtype).tobytes())


def node(operator: str, inputs: Sequence[str], output: str) -> bytes:
    return b"".join(text(1, name) for name in inputs) + text(2, output) + text(4, operator)


def model(
    nodes: Sequence[bytes],
    inputs: Mapping[str, Shape],
    outputs: Mapping[str, Shape],
    constants: Mapping[str, np.ndarray] | None = None,
    metadata: Mapping[str, str] | None = None,
) -> bytes:
    graph = b"".join(text(1, n) for n in nodes) + text(2, "graph")
    graph += b"".join(text(5, constant(*item)) for item in (constants or {}).items())
    graph += b"".join(text(11, value_info(*item)) for item in inputs.items())
    graph += b"".join(text(12, value_info(*item)) for item in outputs.items())
    entries = [text(1, key) + text(2, value) for key, value in (metadata or {}).items()]
    opset = text(8, text(1, "") + number(2, 13))
    return number(1, 8) + text(7, graph) + opset + b"".join(text(14, e) for e in entries)


def write_fixed_answer(
    path: Path,
    answers: Mapping[str, np.ndarray],
    input_shape: Shape,
    metadata: Mapping[str, str] | None = None,
) -> Path:
    """A network that gives the same outputs whatever it sees.

    Zero times the image's mean is added, as some engines refuse outputs without an input.
    """
    constants = {"zero": np.zeros((1, 1, 1, 1))}
    nodes = [node("ReduceMean", ["images"], "mean"), node("Mul", ["mean", "zero"], "nil")]
    for name, array in answers.items():
        constants |= {f"{name}_value": array, f"{name}_rank": np.ones(array.ndim, int)}
        nodes.append(node("Reshape", ["nil", f"{name}_rank"], f"{name}_nil"))
        nodes.append(node("Add", [f"{name}_value", f"{name}_nil"], name))
    outputs = {name: array.shape for name, array in answers.items()}
    path.write_bytes(model(nodes, {"images": input_shape}, outputs, constants, metadata))
    return path


def write_echo(path: Path, input_shape: Shape, operator: str = "Relu") -> Path:
    """A network whose only output is its input passed through one operator."""
    nodes = [node(operator, ["images"], "echo")]
    path.write_bytes(model(nodes, {"images": input_shape}, {"echo": input_shape}))
    return path
