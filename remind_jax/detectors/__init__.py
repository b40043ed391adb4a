"""Instance masks from ONNX segmentation exports or any callable."""

from remind_jax.detectors.detector import CallableDetector as CallableDetector
from remind_jax.detectors.detector import Detector as Detector
from remind_jax.detectors.detector import DropCounts as DropCounts
from remind_jax.detectors.detector import OnnxDetector as OnnxDetector
from remind_jax.detectors.detector import as_detector as as_detector
from remind_jax.detectors.options import DetectorOptions as DetectorOptions
