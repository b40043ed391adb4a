"""A network in ONNX format, run by ONNX Runtime on the CPU: what it takes, gives and says."""

from __future__ import annotations

import dataclasses
import hashlib
import re
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from remind_jax.errors import ConfigError, WeightsError, first_line
from remind_jax.files import as_path, say_no_file

# Of ImageNet, RGB after scaling to [0, 1]: what most published networks were trained with.
MEAN = np.array([0.485, 0.456, 0.406], np.float32)
STD = np.array([0.229, 0.224, 0.225], np.float32)

MAX_INPUT_PX = 8192  # a side of the input of a network
# A file beside the model with the numbers of a tensor, as the format writes it: key, length, name.
_NUMBERS_BESIDE = re.compile(rb"\n\x08location\x12([\x01-\x7f])", re.DOTALL)


@dataclasses.dataclass(frozen=True)
class TensorSpec:
    """Name, shape and element type of an input or output; None stands for a size left open."""

    name: str
    shape: tuple[int | None, ...]
    dtype: str = "float"

    def __str__(self) -> str:
        return f"{self.name} [{', '.join('?' if n is None else str(n) for n in self.shape)}]"


@dataclasses.dataclass(frozen=True)
class Signature:
    """Inputs, outputs and metadata of a model file."""

    path: Path
    inputs: tuple[TensorSpec, ...]
    outputs: tuple[TensorSpec, ...]
    metadata: dict[str, str]


class OnnxModel:
    """A loaded `.onnx` or `.ort` file with one image input; call it to get the outputs by name.

    Raises:
      WeightsError: If the file is missing, damaged, or cannot be run.
      ConfigError: If ONNX Runtime is not installed.
    """

    def __init__(self, path: str | Path, num_threads: int | None = None):
        path = as_path(path, "the model file", WeightsError)
        if wrong := say_no_file(path):
            raise WeightsError(f"model file '{path}' {wrong}; give the path of a .onnx file")
        self._session = _load(path, num_threads)
        told = self._session.get_inputs(), self._session.get_outputs()
        inputs, outputs = (tuple(map(_spec, tensors)) for tensors in told)
        metadata = self._session.get_modelmeta().custom_metadata_map
        self.signature = Signature(path, inputs, outputs, metadata)

    def __call__(self, tensor: Float[np.ndarray, "1 3 H W"]) -> dict[str, np.ndarray]:
        """Runs the model once. Raises WeightsError if the model fails on an input of this shape."""
        spec = self.signature.inputs[0]
        names = [output.name for output in self.signature.outputs]
        dtype = np.float16 if spec.dtype == "float16" else np.float32
        try:
            arrays = self._session.run(names, {spec.name: tensor.astype(dtype, copy=False)})
        except Exception as error:
            raise WeightsError(
                f"'{self.signature.path}' fails in onnxruntime on an input of shape "
                f"{list(tensor.shape)}: {first_line(error)}"
            ) from error
        return {name: np.asarray(a, np.float32) for name, a in zip(names, arrays, strict=True)}


def model_digest(path: Path) -> str:
    """Hash of a model file, and of the files that it keeps its weights in."""
    content = path.read_bytes()
    digest = hashlib.sha256(content)
    found = _NUMBERS_BESIDE.finditer(content)
    for name in sorted({content[one.end() : one.end() + one[1][0]] for one in found}):
        beside = path.parent / name.decode("utf-8", "replace")
        if beside.is_file():
            digest.update(beside.read_bytes())
    return digest.hexdigest()


def image_input(signature: Signature, what: str) -> TensorSpec:
    """A network's only input, floats `[1, 3, H, W]`. Raises WeightsError if it has others."""
    if len(signature.inputs) == 1 and len(signature.inputs[0].shape) == 4:
        (one,) = signature.inputs
        sides = [side for side in one.shape[2:] if side is not None]
        if max(sides, default=0) > MAX_INPUT_PX:
            raise WeightsError(
                f"'{signature.path}' takes images of {sides} pixels; at most {MAX_INPUT_PX} a side "
                "are accepted, export it for smaller ones"
            )
        is_float = one.dtype in ("float", "float16")
        if one.shape[0] in (1, None) and one.shape[1] in (3, None) and is_float:
            return one
    found = ", ".join(f"{one} of {one.dtype}" for one in signature.inputs) or "none"
    raise WeightsError(
        f"'{signature.path}' has the inputs {found}; {what} has one, an RGB image [1, 3, H, W] of "
        "floats"
    )


def _spec(tensor: Any) -> TensorSpec:
    """What ONNX Runtime tells of a tensor; it gives sizes left open a name."""
    shape = tuple(n if isinstance(n, int) and n > 0 else None for n in tensor.shape)
    return TensorSpec(tensor.name, shape, tensor.type.removeprefix("tensor(").removesuffix(")"))


def _load(path: Path, num_threads: int | None) -> Any:
    try:
        import onnxruntime
    except ImportError as error:
        raise ConfigError(
            f"'{path}' needs onnxruntime, which is not installed; pip install 'remind-jax[detect]'"
        ) from error
    options = onnxruntime.SessionOptions()
    options.log_severity_level = 3  # errors only: they are raised, not needed on the terminal
    # Idle threads would spin and take the cores that the tracker needs meanwhile.
    options.add_session_config_entry("session.intra_op.allow_spinning", "0")
    if num_threads is not None:
        options.intra_op_num_threads = num_threads
    try:
        return onnxruntime.InferenceSession(
            str(path), sess_options=options, providers=["CPUExecutionProvider"]
        )
    except Exception as error:  # of somebody else's code
        raise WeightsError(
            f"'{path}' is damaged or no ONNX file: onnxruntime cannot load it "
            f"({first_line(error)}); export or download it again"
        ) from error
