"""What finds instances in a frame: an ONNX segmentation export, or any callable.

Masks that erosion leaves empty are dropped and counted (method.md#detector-masks).
"""

from __future__ import annotations

import dataclasses
import os
from collections import Counter
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

import numpy as np
from jaxtyping import UInt8

from remind_jax.crops import Crops
from remind_jax.detectors import rfdetr_seg, yolo_seg
from remind_jax.detectors.exports import refuse_other_formats
from remind_jax.detectors.onnx_model import OnnxModel, Signature, image_input
from remind_jax.detectors.options import DetectorOptions
from remind_jax.errors import ConfigError, WeightsError
from remind_jax.files.host_array import host_array
from remind_jax.frame import Detections, check_image, check_size
from remind_jax.settings.ranges import read_options

# What is known of one family of networks: `prepare` a frame, `decode` the outputs.
SegmentationHead = yolo_seg.YoloSeg | rfdetr_seg.RfDetrSeg

# Another's masks are taken as they are unless the caller asks for more.
_AS_GIVEN = DetectorOptions(confidence=0.0, erosion_px=0)

# How many instances were dropped for their masks, by reason:
#   empty    the detector's mask had no pixel
#   eroded   erosion left nothing
#   small    fewer than `min_mask_px` pixels left
DropCounts = Counter[str]


@runtime_checkable
class Detector(Protocol):
    """Finds the instances of a frame.

    Attributes:
      dropped: Instances left out so far for their masks, by reason.
    """

    dropped: DropCounts

    def __call__(self, image: UInt8[np.ndarray, "H W 3"]) -> Detections:
        """Instances of one RGB frame, in detector order."""
        ...

    def describe(self) -> dict[str, Any]:
        """What it is and how it is set, fit for JSON."""
        ...


class _Refined:
    """Calls `_detect` and refines what it finds."""

    def __init__(self, options: DetectorOptions) -> None:
        self.options = options
        self.dropped = DropCounts()

    def __call__(self, image: UInt8[np.ndarray, "H W 3"]) -> Detections:
        """Instances of one RGB frame, in the order in which they were found.

        Raises:
          SourceError: If the frame is not an RGB image of bytes, or a function's answer is in no
            form that `remind_jax.sources.detections.detections_from` understands.
          WeightsError: If the network fails on it.
        """
        image = host_array(image, "pixels of the frame")
        check_image("what the detector got", image)
        size = check_size(image.shape[:2])
        detections, drops = refine_detections(self._detect(image, size), self.options)
        self.dropped += drops
        return detections

    def _detect(self, image: np.ndarray, size: tuple[int, int]) -> Detections:
        raise NotImplementedError


class OnnxDetector(_Refined):
    """A segmentation network from an ONNX file, recognized by its outputs; best instances first."""

    def __init__(self, path: str | Path, options: DetectorOptions | None = None):
        """Loads and recognizes the network.

        Raises:
          WeightsError: If the file is missing, damaged, of an unknown kind or cannot be run.
          ConfigError: If an option does not fit the network.
        """
        super().__init__(options or DetectorOptions())
        refuse_other_formats(Path(path))
        self._model = OnnxModel(path, self.options.num_threads)
        self._head = recognize_head(self._model.signature, self.options)

    def _detect(self, image: np.ndarray, size: tuple[int, int]) -> Detections:
        return self._head.decode(self._model(self._head.prepare(image)), size)

    def describe(self) -> dict[str, Any]:
        """Kind of network, file, classes and options, fit for JSON."""
        return {
            "kind": self._head.kind,
            "file": str(self._model.signature.path),
            "classes": [name for name in self._head.names if name is not None],
            "options": dataclasses.asdict(self.options),
        }


class CallableDetector(_Refined):
    """Any function from an RGB frame to instances, whatever type it answers with."""

    def __init__(self, function: Callable[[Any], Any], options: DetectorOptions | None = None):
        super().__init__(options or _AS_GIVEN)
        self._function = function

    def _detect(self, image: np.ndarray, size: tuple[int, int]) -> Detections:
        from remind_jax.sources.detections import detections_from

        return detections_from(self._function(image), size, class_names=self.options.class_names)

    def describe(self) -> dict[str, Any]:
        """The function's name, the options, and what it says of itself, fit for JSON."""
        name = getattr(self._function, "__qualname__", type(self._function).__qualname__)
        told = {"kind": "callable", "function": name, "options": dataclasses.asdict(self.options)}
        return told | getattr(self._function, "describe", dict)()


def refine_detections(
    detections: Detections, options: DetectorOptions
) -> tuple[Detections, DropCounts]:
    """The wanted instances in turn, with eroded masks, and how many their masks excluded."""
    is_admitted = np.array([options.admits(label) for label in detections.labels], bool)
    detections = detections.select((detections.scores >= options.confidence) & is_admitted)
    crops = Crops.of(detections.masks)
    left = crops.eroded(options.erosion_px, margin_px=options.erosion_px)
    keep, empty = left.areas >= options.min_mask_px, crops.areas == 0
    eroded = ~empty & (left.areas == 0)
    small = ~keep & ~empty & ~eroded
    drops = DropCounts(empty=int(empty.sum()), eroded=int(eroded.sum()), small=int(small.sum()))
    return dataclasses.replace(detections, masks=np.asarray(left)).select(keep), drops


def as_detector(
    spec: Any, options: DetectorOptions | Mapping[str, Any] | None = None
) -> Detector | None:
    """Makes a detector from what a user gives.

    Args:
      spec: Path of an `.onnx` file, a `Detector`, any callable from an RGB frame to instances
        in any form of `remind_jax.sources.detections_from`, or None.
      options: Thresholds and class lists. Without them an ONNX model gets the defaults, and a
        callable's masks are taken as they are. A `Detector` keeps its own.

    Returns:
      The detector; None for None.

    Raises:
      ConfigError: If the specification is none of these, or an option does not fit.
      WeightsError: If the file cannot be used.
    """
    if options is not None:
        options = read_options("detector_options", options, DetectorOptions)
    if spec is None or isinstance(spec, Detector):
        return spec
    if isinstance(spec, (str, os.PathLike)):
        return OnnxDetector(Path(spec), options)
    if callable(spec):
        return CallableDetector(spec, options)
    raise ConfigError(
        f"a detector cannot be made from {type(spec).__name__}; "
        "give the path of a .onnx file or a function from an RGB image to instances"
    )


def recognize_head(file: Signature, options: DetectorOptions) -> SegmentationHead:
    """Chooses the family of a network by the shapes of its outputs.

    Raises:
      WeightsError: If the input is not one RGB image or the outputs are of no known family.
      ConfigError: If an option does not fit the network.
    """
    image_input(file, "a detector")
    if (yolo := yolo_seg.recognize_yolo_seg(file.outputs)) is not None:
        return yolo_seg.YoloSeg.from_file(file, yolo, options)
    if (rfdetr := rfdetr_seg.recognize_rfdetr_seg(file.outputs)) is not None:
        return rfdetr_seg.RfDetrSeg.from_file(file, rfdetr, options)
    found = ", ".join(map(str, file.outputs))
    raise WeightsError(
        f"'{file.path}' has outputs of no known segmentation network ({found}); "
        f"known are {yolo_seg.KNOWN_SHAPES}, and {rfdetr_seg.KNOWN_SHAPES}"
    )
