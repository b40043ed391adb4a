"""Runs an ONNX model on the CPU: onnxruntime where it is installed, otherwise cv2.dnn."""

from __future__ import annotations

import contextlib
import importlib.util
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from jaxtyping import Float

from remind_jax.detectors.onnx_file import OnnxFile, TensorSpec
from remind_jax.errors import ConfigError, WeightsError, first_line

_SILENT = 0  # OpenCV's log level
_INSTALL = "pip install 'remind-jax[detect]'"


class OnnxSession:
    """A loaded model with one image input; call it with the input, get the outputs by name.

    Attributes:
      file: Signature and metadata.
      engine: The library that runs it, `onnxruntime` or `cv2.dnn`.
    """

    def __init__(self, file: OnnxFile, engine: str = "auto", num_threads: int | None = None):
        """Loads the model.

        Args:
          file: The model's file, with the image as its only input.
          engine: `onnxruntime`, `cv2.dnn`, or `auto` for the first of them that is installed.
          num_threads: Threads within one operator (onnxruntime only: OpenCV has one setting for
            the whole process, which is left alone).

        Raises:
          WeightsError: If the engine cannot run the model.
          ConfigError: If the engine is not installed.
        """
        self.file = file
        self.engine = _choose_engine(engine)
        if self.engine == "onnxruntime":
            self._model = _load_onnxruntime(self.file.path, num_threads)
        else:
            self._model = _load_cv2(self.file.path)

    def __call__(self, tensor: Float[np.ndarray, "1 3 H W"]) -> dict[str, np.ndarray]:
        """Runs the model once.

        Raises:
          WeightsError: If the model fails on an input of this shape.
        """
        spec = self.file.inputs[0]
        names = [output.name for output in self.file.outputs]
        try:
            if self.engine == "onnxruntime":
                dtype = np.float16 if spec.dtype == "float16" else np.float32
                arrays = self._model.run(names, {spec.name: tensor.astype(dtype, copy=False)})
            else:
                self._model.setInput(tensor, spec.name)
                arrays = self._model.forward(_cv2_names(self._model, names))
        except Exception as error:
            raise WeightsError(
                f"'{self.file.path}' fails in {self.engine} on an input of shape "
                f"{list(tensor.shape)}: {first_line(error)}"
            ) from error
        return {
            name: np.asarray(array, np.float32) for name, array in zip(names, arrays, strict=True)
        }


def read_model(path: str | Path) -> OnnxFile:
    """A model's signature, of an `.onnx` file or of one in onnxruntime's own format, `.ort`.

    Raises:
      WeightsError: If the file is missing, of no such kind or cut short.
      ConfigError: If it is an `.ort` file and onnxruntime is not installed.
    """
    path = Path(path)
    if path.suffix.lower() != ".ort" or not path.is_file():
        return OnnxFile.read(path)
    _choose_engine("onnxruntime")
    session = _load_onnxruntime(path, 1)
    inputs, outputs = (
        tuple(TensorSpec(one.name, _sizes(one.shape), _element_type(one.type)) for one in told)
        for told in (session.get_inputs(), session.get_outputs())
    )
    return OnnxFile(path, inputs, outputs, session.get_modelmeta().custom_metadata_map)


def _sizes(shape: list[int | str | None]) -> tuple[int | None, ...]:
    """Known sizes; onnxruntime gives those left open names."""
    return tuple(n if isinstance(n, int) and n > 0 else None for n in shape)


def _element_type(told: str) -> str:
    """`tensor(float)` in the words of `TensorSpec`."""
    inner = told.removeprefix("tensor(").removesuffix(")")
    return {"float": "float32", "double": "float64"}.get(inner, inner)


def _choose_engine(engine: str) -> str:
    has_onnxruntime = importlib.util.find_spec("onnxruntime") is not None
    if engine == "auto":
        return "onnxruntime" if has_onnxruntime else "cv2.dnn"
    if engine == "onnxruntime" and not has_onnxruntime:
        raise ConfigError(f"detector engine onnxruntime is not installed; {_INSTALL}")
    return engine


def _load_onnxruntime(path: Path, num_threads: int | None) -> Any:
    import onnxruntime

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
    except Exception as error:
        raise WeightsError(f"onnxruntime cannot load '{path}': {first_line(error)}") from error


def _load_cv2(path: Path) -> Any:
    try:
        with _quiet_cv2():
            return cv2.dnn.readNetFromONNX(str(path))
    except cv2.error as error:
        operator = re.search(r"Node \[(\w+)", str(error))
        reason = f"it does not know the operator {operator[1]}" if operator else first_line(error)
        raise WeightsError(
            f"cv2.dnn cannot load '{path}' ({reason}); use onnxruntime: {_INSTALL}"
        ) from error


@contextlib.contextmanager
def _quiet_cv2() -> Iterator[None]:
    """Keeps OpenCV from printing what is raised as an error anyway."""
    logging: Any = getattr(cv2.utils, "logging", cv2)  # OpenCV 4 has the two functions at the top
    level = logging.getLogLevel()
    logging.setLogLevel(_SILENT)
    try:
        yield
    finally:
        logging.setLogLevel(level)


def _cv2_names(net: Any, names: list[str]) -> list[str]:
    """OpenCV's names of the outputs, in the file's order.

    Some versions give layer names; those come in the file's order.
    """
    own = list(net.getUnconnectedOutLayersNames())
    return own if set(own) != set(names) and len(own) == len(names) else names
