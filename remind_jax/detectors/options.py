"""How a detector's raw answers become the instances that the tracker sees."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Bool

from remind_jax.detectors.exports import is_class_name
from remind_jax.detectors.onnx_model import MAX_INPUT_PX
from remind_jax.errors import ConfigError, OptionError, nearest_names
from remind_jax.files.limits import MAX_LABEL
from remind_jax.settings.ranges import check_option


@dataclasses.dataclass(frozen=True)
class DetectorOptions:
    """Thresholds and class lists of a detector.

    All fields apply to ONNX models. Of a callable's answers only `confidence`, `classes`,
    `ignored_classes`, `erosion_px` and `min_mask_px` change anything: the callable does the rest.
    """

    confidence: float = 0.25  # lowest score that is kept; the paper's runs used 0.7
    iou: float = 0.5  # two boxes that overlap more are one thing (networks that need suppression)
    suppress_across_classes: bool = False  # boxes of two classes may be one thing too
    max_detections: int = 100  # the best-scored ones are kept
    mask_threshold: float = 0.5  # probability from which a pixel belongs to an instance
    erosion_px: int = 2  # square kernel of 2 r + 1, once; the image border does not eat into masks
    min_mask_px: int = 1  # smaller masks are dropped and counted, after erosion
    classes: tuple[str, ...] | None = None  # keep only these, any letter case; all if left out
    ignored_classes: tuple[str, ...] = ()  # never kept, any letter case
    class_names: tuple[str, ...] | None = None  # by index, in the place of the file's own
    input_size_px: int | None = None  # longer side of the input of models that leave it open
    num_threads: int | None = None  # of onnxruntime in one operator; it chooses if left out

    def __post_init__(self):
        for name in ("classes", "ignored_classes", "class_names"):
            object.__setattr__(self, name, _names(name, getattr(self, name)))
        for name, least, most in (
            ("confidence", 0.0, 1.0),
            ("iou", 0.0, 1.0),
            ("mask_threshold", 0.01, 0.99),
            ("max_detections", 1, 10_000),
            ("erosion_px", 0, 100),
            ("min_mask_px", 1, MAX_INPUT_PX**2),
            ("input_size_px", 32, MAX_INPUT_PX),
            ("num_threads", 1, 1024),
        ):
            value = getattr(self, name)
            if value is not None or name not in ("input_size_px", "num_threads"):
                check_option(name, value, least, most, whole=isinstance(least, int))

    def admits(self, label: str) -> bool:
        """Whether instances of the class `label` are wanted."""
        folded = label.casefold()
        if folded in map(str.casefold, self.ignored_classes):
            return False
        return self.classes is None or folded in map(str.casefold, self.classes)


def find_wanted_classes(
    names: Sequence[str | None], options: DetectorOptions
) -> Bool[np.ndarray, "C"]:
    """Which columns give detections; unnamed ones never. Raises ConfigError for unknown classes."""
    known = [name for name in names if name is not None]
    for name in (*(options.classes or ()), *options.ignored_classes):
        if name.casefold() not in map(str.casefold, known):
            raise ConfigError(f"the detector has no class {name!r}; {nearest_names(name, known)}")
    return np.array([name is not None and options.admits(name) for name in names], bool)


def _names(field: str, value: Any) -> tuple[str, ...] | None:
    if value is None and field != "ignored_classes":
        return None
    is_list = isinstance(value, (list, tuple, set, frozenset))
    if is_list and all(isinstance(n, str) and is_class_name(n) for n in value):
        return tuple(sorted(value) if isinstance(value, (set, frozenset)) else value)
    raise OptionError(
        f"'{field}' is {repr(value)[:60]}; give a list of class names of 1 to {MAX_LABEL} "
        "characters, for example ['chair']",
        field,
    )
