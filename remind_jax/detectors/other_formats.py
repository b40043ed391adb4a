"""Model files that are no ONNX, and how to make one of them."""

from __future__ import annotations

from pathlib import Path

from remind_jax.errors import WeightsError

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
_RFDETR = 'in Python, RFDETRSegMedium(pretrain_weights="{file}").export()'


def refuse_other_formats(path: Path) -> None:
    """Tells how to export what is no ONNX file.

    Raises:
      WeightsError: If the path names a model of another format, a folder, or nothing.
    """
    suffix = path.suffix.lower()
    if suffix in _FORMATS:
        raise WeightsError(
            f"'{path}' is {_FORMATS[suffix]}, and a detector is read as ONNX; export it once, with "
            f"Ultralytics: {_export_command(path)}" + _with_rfdetr(path)
        )
    if path.is_dir():
        raise WeightsError(f"detector '{path}' is a folder; give a .onnx file")
    if not path.is_file():
        raise WeightsError(
            f"detector '{path}' does not exist; give a .onnx file, which Ultralytics makes of its "
            f"networks: {_export_command(path)}"
        )


def _export_command(path: Path) -> str:
    """What is typed to make an ONNX file of a network that Ultralytics knows."""
    return f"yolo export model={path.with_suffix('.pt').name} format=onnx"


def _with_rfdetr(path: Path) -> str:
    """RF-DETR ships its weights as .pth."""
    return f"; RF-DETR: {_RFDETR.format(file=path.name)}" if path.suffix.lower() == ".pth" else ""
