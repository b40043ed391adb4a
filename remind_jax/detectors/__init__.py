"""Instance masks from ONNX segmentation exports or any callable."""

from remind_jax.detectors.detector import (
    CallableDetector,
    Detector,
    DropCounts,
    OnnxDetector,
    as_detector,
)
from remind_jax.detectors.options import DetectorOptions

__all__ = [
    "CallableDetector",
    "Detector",
    "DetectorOptions",
    "DropCounts",
    "OnnxDetector",
    "as_detector",
]
