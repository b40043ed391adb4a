"""What an ONNX file says about itself: inputs, outputs, metadata and class names; other formats.

Read without any runtime. ONNX files are Protocol Buffers messages. Only the few fields named below
are read (numbers from `onnx.proto3`); weights are skipped, so this takes milliseconds whatever the
model's size.
"""

from __future__ import annotations

import ast
import dataclasses
import json
import mmap
import re
from collections.abc import Iterator, Mapping
from pathlib import Path

from remind_jax.errors import WeightsError
from remind_jax.files import as_path, say_no_file
from remind_jax.files.limits import MAX_LABEL

_MODEL_GRAPH, _MODEL_METADATA = 7, 14
_GRAPH_INITIALIZER, _GRAPH_INPUT, _GRAPH_OUTPUT = 5, 11, 12
_TENSOR_NAME = 8
_VARINT, _FIXED64, _BYTES, _FIXED32 = 0, 1, 2, 5
_DTYPES = {1: "float32", 2: "uint8", 10: "float16", 11: "float64"}

_FORMATS = {
    ".pt": "PyTorch weights",
    ".pth": "PyTorch weights",
    ".ckpt": "PyTorch weights",
    ".safetensors": "weights without their network",
    ".torchscript": "a TorchScript model",
    ".engine": "a TensorRT engine",
    ".trt": "a TensorRT engine",
    ".plan": "a TensorRT engine",
    ".tflite": "a TensorFlow Lite model",
    ".pb": "a TensorFlow model",
    ".h5": "a Keras model",
    ".keras": "a Keras model",
    ".mlmodel": "a Core ML model",
    ".mlpackage": "a Core ML model",
    ".xml": "an OpenVINO model",
    ".mnn": "an MNN model",
    ".param": "an ncnn model",
}
# Names of RF-DETR's segmentation networks, by how their files are called: rf-detr-seg-nano.
_RFDETR_NAME = re.compile(r"rf-?detr-?seg-?(nano|small|medium|xxlarge|xlarge|2xlarge|large)")
_RFDETR_CLASSES = {"xlarge": "XLarge", "xxlarge": "2XLarge", "2xlarge": "2XLarge"}

_MOST_CLASSES = 100_000
_MOST_FIELDS = 1_000_000  # of one message
_MOST_LITERAL = 10_000_000  # characters of a value in the metadata
MOST_INPUT_PX = 8192  # a side of the input of a network

Message = dict[int, list["int | memoryview"]]


@dataclasses.dataclass(frozen=True)
class TensorSpec:
    """Name, shape and element type of an input or output; None stands for a size left open."""

    name: str
    shape: tuple[int | None, ...]
    dtype: str

    def __str__(self) -> str:
        return f"{self.name} [{', '.join('?' if n is None else str(n) for n in self.shape)}]"


@dataclasses.dataclass(frozen=True)
class OnnxFile:
    """Signature and metadata of a model file."""

    path: Path
    inputs: tuple[TensorSpec, ...]
    outputs: tuple[TensorSpec, ...]
    metadata: dict[str, str]

    @classmethod
    def read(cls, path: str | Path) -> OnnxFile:
        """Reads a file's signature.

        Raises:
          WeightsError: If the file is missing, is no ONNX file or is cut short.
        """
        path = as_path(path, "the model file", WeightsError)
        if wrong := say_no_file(path):
            raise WeightsError(f"model file '{path}' {wrong}; give the path of a .onnx file")
        try:
            with path.open("rb") as file:
                data = memoryview(mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ))
            model = _parse(data)
            graph = _parse(_one(model, _MODEL_GRAPH))
            constants = {
                _text(_parse(_bytes(tensor)), _TENSOR_NAME)
                for tensor in graph.get(_GRAPH_INITIALIZER, [])
            }
            inputs = tuple(_tensor_spec(v) for v in graph.get(_GRAPH_INPUT, []))
            outputs = tuple(_tensor_spec(v) for v in graph.get(_GRAPH_OUTPUT, []))
            entries = [_parse(_bytes(entry)) for entry in model.get(_MODEL_METADATA, [])]
            metadata = {_text(entry, 1): _text(entry, 2) for entry in entries}
        except (ValueError, IndexError) as error:
            raise WeightsError(
                f"'{path}' is not a complete ONNX file; export or download it again"
            ) from error
        except OSError as error:
            raise WeightsError(f"model file '{path}' cannot be read: {error.strerror}") from error
        inputs = tuple(spec for spec in inputs if spec.name not in constants)
        return cls(path, inputs, outputs, metadata)


def read_class_names(metadata: Mapping[str, str]) -> dict[int, str]:
    """Class index to name; without those that are no names, empty if there are none.

    Ultralytics writes `names` as a Python dictionary in text, RF-DETR (from 2026) writes
    `rfdetr_inference`, JSON with `class_id_to_name`.
    """
    if "rfdetr_inference" in metadata:
        inference = parse_literal(metadata["rfdetr_inference"])
        named = inference.get("class_id_to_name") if isinstance(inference, dict) else None
    else:
        named = parse_literal(metadata.get("names", ""))
    if isinstance(named, (list, tuple)):
        named = dict(enumerate(named))
    if not isinstance(named, dict):
        return {}
    try:
        by_index = {int(index): name for index, name in named.items()}
    except (TypeError, ValueError):
        return {}
    return {
        i: name for i, name in by_index.items() if 0 <= i < _MOST_CLASSES and is_class_name(name)
    }


def is_class_name(name: object) -> bool:
    """Whether it can be the name of a class."""
    return isinstance(name, str) and bool(name.strip()) and len(name) <= MAX_LABEL


def parse_literal(text: str) -> object:
    """The value of a JSON text or Python literal; None if it is neither. Nothing is executed."""
    for parse in (json.loads, ast.literal_eval):
        if len(text) > _MOST_LITERAL:
            return None
        try:
            return parse(text)
        except (ValueError, SyntaxError, TypeError, MemoryError, RecursionError):
            continue
    return None


def refuse_other_formats(path: Path) -> None:
    """Tells how to export what is no ONNX file.

    Raises:
      WeightsError: If the path names a model of another format, a folder, or nothing.
    """
    suffix = path.suffix.lower()
    if suffix in _FORMATS:
        raise WeightsError(
            f"'{path}' is {_FORMATS[suffix]}, and a detector is read as ONNX; export it once, "
            f"{_export_commands(path)}"
        )
    if wrong := say_no_file(path):
        how = f", which is exported once, {_export_commands(path)}" if not path.is_dir() else ""
        raise WeightsError(f"detector '{path}' {wrong}; give a .onnx file{how}")


def _export_commands(path: Path) -> str:
    """What is typed to make an ONNX file of a network, by those who know it."""
    found = _RFDETR_NAME.search(path.name.lower())
    size = found[1] if found else "medium"
    network = f"RFDETRSeg{_RFDETR_CLASSES.get(size, size.capitalize())}"
    given = f'pretrain_weights="{path.name}"' if path.suffix.lower() in (".pt", ".pth") else ""
    rfdetr = (
        "with RF-DETR (Apache-2.0; pip install 'rfdetr[onnx]'), in Python: "
        f"rfdetr.{network}({given}).export()"
    )
    yolo = (
        "with Ultralytics (AGPL-3.0; pip install ultralytics): yolo export "
        f"model={path.with_suffix('.pt').name} format=onnx"
    )
    if found:
        return rfdetr
    return f"{yolo}, or {rfdetr}" if path.suffix.lower() == ".pth" else yolo


def image_input(file: OnnxFile, what: str) -> TensorSpec:
    """The only input of a network of one RGB image, `[1, 3, H, W]` of floats.

    Raises:
      WeightsError: If it has other inputs; says what needs such an input.
    """
    if len(file.inputs) == 1 and len(file.inputs[0].shape) == 4:
        batch, channels, *_ = file.inputs[0].shape
        is_float = file.inputs[0].dtype in ("float32", "float16")
        sides = [side for side in file.inputs[0].shape[2:] if side is not None]
        if max(sides, default=0) > MOST_INPUT_PX:
            raise WeightsError(
                f"'{file.path}' takes images of {sides} pixels; at most {MOST_INPUT_PX} a side are "
                "accepted, export it for smaller ones"
            )
        if batch in (1, None) and channels in (3, None) and is_float:
            return file.inputs[0]
    found = ", ".join(f"{one} of {one.dtype}" for one in file.inputs) or "none"
    raise WeightsError(
        f"'{file.path}' has the inputs {found}; {what} has one, an RGB image [1, 3, H, W] of floats"
    )


def _parse(data: memoryview) -> Message:
    fields: Message = {}
    for count, (number, value) in enumerate(_walk(data)):
        if count > _MOST_FIELDS:
            raise ValueError("too many fields")
        fields.setdefault(number, []).append(value)
    return fields


def _walk(data: memoryview) -> Iterator[tuple[int, int | memoryview]]:
    position = 0
    while position < len(data):
        key, position = _varint(data, position)
        number, wire_type = key >> 3, key & 7
        if wire_type == _VARINT:
            value, position = _varint(data, position)
            yield number, value
            continue
        if wire_type == _BYTES:
            size, position = _varint(data, position)
        elif wire_type in (_FIXED32, _FIXED64):
            size = 4 if wire_type == _FIXED32 else 8
        else:
            raise ValueError(f"wire type {wire_type}")
        if number == 0 or position + size > len(data):
            raise ValueError("field beyond the end")
        yield number, data[position : position + size]
        position += size


def _varint(data: memoryview, position: int) -> tuple[int, int]:
    value = 0
    for shift in range(0, 70, 7):
        byte = data[position]
        position += 1
        value |= (byte & 0x7F) << shift
        if byte < 0x80:
            return value, position
    raise ValueError("number of more than 10 bytes")


def _bytes(value: int | memoryview) -> memoryview:
    if isinstance(value, int):
        raise ValueError("a number where a message belongs")
    return value


def _one(message: Message, number: int) -> memoryview:
    if number not in message:
        raise ValueError(f"field {number} is missing")
    return _bytes(message[number][-1])


def _text(message: Message, number: int) -> str:
    return bytes(_one(message, number)).decode("utf-8") if number in message else ""


def _tensor_spec(value: int | memoryview) -> TensorSpec:
    info = _parse(_bytes(value))
    tensor = _parse(_one(_parse(_one(info, 2)), 1))
    code = tensor.get(1, [0])[-1]
    shape = _parse(_one(tensor, 2)) if 2 in tensor else {}
    sizes = [_parse(_bytes(dimension)).get(1, [0])[-1] for dimension in shape.get(1, [])]
    dtype = _DTYPES.get(code, f"type {code}") if isinstance(code, int) else "unknown"
    # Exporters write -1, a ten-byte varint, for a size that they leave open.
    known = tuple(n if isinstance(n, int) and 0 < n < 2**63 else None for n in sizes)
    return TensorSpec(_text(info, 1), known, dtype)
