"""How detectors are exported to ONNX, and the class names that exporters write into the file."""

from __future__ import annotations

import ast
import json
import re
from collections.abc import Mapping
from pathlib import Path

from remind_jax.errors import WeightsError
from remind_jax.files import say_no_file
from remind_jax.files.limits import MAX_LABEL

# Of networks that are no ONNX files.
_OTHER_SUFFIXES = (
    *(".pt", ".pth", ".ckpt", ".safetensors", ".torchscript", ".engine", ".trt", ".plan"),
    *(".tflite", ".pb", ".h5", ".keras", ".mlmodel", ".mlpackage", ".xml", ".mnn", ".param"),
)
# Names of RF-DETR's segmentation networks, by how their files are called: rf-detr-seg-nano.
_RFDETR_NAME = re.compile(r"rf-?detr-?seg-?(nano|small|medium|xxlarge|xlarge|2xlarge|large)")
_RFDETR_CLASSES = {"xlarge": "XLarge", "xxlarge": "2XLarge", "2xlarge": "2XLarge"}
_MAX_CLASSES = 100_000
_MAX_LITERAL = 10_000_000  # characters of a value in the metadata


def read_class_names(metadata: Mapping[str, str]) -> dict[int, str]:
    """Class index to name; without those that are no names, empty if there are none.

    Ultralytics writes `names` as a Python dictionary in text, RF-DETR (from 2026) writes
    `rfdetr_inference`, JSON with `class_id_to_name`.
    """
    named = parse_literal(metadata.get("names", ""))
    if "rfdetr_inference" in metadata:
        inference = parse_literal(metadata["rfdetr_inference"])
        named = inference.get("class_id_to_name") if isinstance(inference, dict) else None
    if isinstance(named, (list, tuple)):
        named = dict(enumerate(named))
    try:
        by_index = {int(i): name for i, name in named.items()} if isinstance(named, dict) else {}
    except (TypeError, ValueError):
        return {}
    return {i: n for i, n in by_index.items() if 0 <= i < _MAX_CLASSES and is_class_name(n)}


def is_class_name(name: object) -> bool:
    """Whether it can be the name of a class."""
    return isinstance(name, str) and bool(name.strip()) and len(name) <= MAX_LABEL


def parse_literal(text: str) -> object:
    """The value of a JSON text or Python literal; None if it is neither. Nothing is executed."""
    for parse in (json.loads, ast.literal_eval) if len(text) <= _MAX_LITERAL else ():
        try:
            return parse(text)
        except (ValueError, SyntaxError, TypeError, MemoryError, RecursionError):
            continue
    return None


def refuse_other_formats(path: Path) -> None:
    """Raises a WeightsError that tells how to export what is no ONNX file, or is missing."""
    if path.suffix.lower() in _OTHER_SUFFIXES:
        raise WeightsError(
            f"'{path}' is no ONNX file, as a detector must be; export it once, "
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
