"""RF-DETR segmentation exports (roboflow/rf-detr, `model.export()`).

Letters: `Q` queries, `C` class columns, `mh mw` mask grid, `H W` network input, `h w` frame.

Assumed, from the package's own export and post-processing code (releases 1.3 to 2026):
* input: RGB in [0, 1], minus the ImageNet mean, over its deviation; plain bilinear resize to the
  input size without antialiasing, aspect not kept;
* outputs: `dets [1, Q, 4]` (center x, center y, width, height as fractions of the frame), `labels
  [1, Q, C]` (logits), `masks [1, Q, mh, mw]` (logits; early exports give them a number as name);
* a score is the sigmoid of a logit, each class for itself, no softmax; no suppression is needed;
* the package takes the best of all `Q * C` pairs, so one query can come twice under two classes;
  here a query is one thing and keeps its best class, as a tracker must not see a mask twice;
* masks are resized bilinearly as logits, cut at the logit of the threshold, and not cut to boxes;
* class columns are `C = classes + 1`. Where the file names its columns, columns without name count
  for nothing. Without names, 91 columns are taken for the COCO category numbers of the pretrained
  models (the last one is a real class there), and otherwise the last column is the "no object" of
  fine-tuned models and counts for nothing. `class_names` in the options settles it.

Of an export of `RFDETRSegNano` by release 1.11.2 with random numbers, on one picture of 640x480,
the 68 instances that both count under the same class have the package's score within 1e-6 and its
mask with an IoU of at least 0.99998.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence

import cv2
import numpy as np
from jaxtyping import Bool, Float, UInt8
from scipy.special import expit, logit

from remind_jax.detectors.exports import read_class_names
from remind_jax.detectors.onnx_model import MEAN, STD, Signature, TensorSpec
from remind_jax.detectors.options import DetectorOptions, find_wanted_classes
from remind_jax.errors import ConfigError, OptionError, WeightsError
from remind_jax.frame import Detections

KNOWN_SHAPES = "RF-DETR-seg dets [1, Q, 4], labels [1, Q, C], masks [1, Q, mh, mw]"

# COCO's category numbers have gaps; '-' stands for a number that was never used.
_COCO_TEXT = (
    "-,person,bicycle,car,motorcycle,airplane,bus,train,truck,boat,traffic light,fire hydrant,-,"
    "stop sign,parking meter,bench,bird,cat,dog,horse,sheep,cow,elephant,bear,zebra,giraffe,-,"
    "backpack,umbrella,-,-,handbag,tie,suitcase,frisbee,skis,snowboard,sports ball,kite,"
    "baseball bat,baseball glove,skateboard,surfboard,tennis racket,bottle,-,wine glass,cup,fork,"
    "knife,spoon,bowl,banana,apple,sandwich,orange,broccoli,carrot,hot dog,pizza,donut,cake,chair,"
    "couch,potted plant,bed,-,dining table,-,-,toilet,-,tv,laptop,mouse,remote,keyboard,cell phone,"
    "microwave,oven,toaster,sink,refrigerator,-,book,clock,vase,scissors,teddy bear,hair drier,"
    "toothbrush"
)
_COCO_NAMES = tuple(None if name == "-" else name for name in _COCO_TEXT.split(","))


@dataclasses.dataclass(frozen=True)
class RfDetrLayout:
    """Which output is which."""

    boxes: str  # output names
    labels: str
    masks: str
    num_columns: int


def recognize_rfdetr_seg(outputs: Sequence[TensorSpec]) -> RfDetrLayout | None:
    """Finds the outputs by name, else by shape and order; None if they are not RF-DETR-seg.

    Names come first because a model of three classes has labels of the shape of boxes.
    """
    planes = [output for output in outputs if len(output.shape) == 4]
    rows = [output for output in outputs if len(output.shape) == 3]
    if len(outputs) != 3 or len(planes) != 1 or len(rows) != 2:
        return None
    boxes, labels = rows
    four_wide = [row for row in rows if row.shape[2] == 4]
    if {row.name for row in rows} == {"dets", "labels"}:
        boxes, labels = sorted(rows, key=lambda row: row.name)
    elif len(four_wide) == 1 and four_wide[0] is labels:
        boxes, labels = labels, boxes
    if boxes.shape[2] not in (4, None) or labels.shape[2] is None:
        return None
    return RfDetrLayout(boxes.name, labels.name, planes[0].name, labels.shape[2])


@dataclasses.dataclass(frozen=True, eq=False)
class RfDetrSeg:
    """Turns frames into the network's input and its outputs into detections."""

    layout: RfDetrLayout
    names: tuple[str | None, ...]  # by class column; None where a column is no class
    wanted: Bool[np.ndarray, "C"]
    input_size: tuple[int, int]
    options: DetectorOptions

    kind = "rfdetr-seg"

    @classmethod
    def from_file(
        cls, file: Signature, layout: RfDetrLayout, options: DetectorOptions
    ) -> RfDetrSeg:
        """Reads names and input size from the file. Raises ConfigError if options do not fit it."""
        if options.class_names is not None and len(options.class_names) > layout.num_columns:
            raise ConfigError(
                f"{len(options.class_names)} class_names were given, "
                f"but '{file.path}' has {layout.num_columns} class columns"
            )
        found = dict(enumerate(options.class_names or ())) or read_class_names(file.metadata)
        names = name_columns(layout.num_columns, found)
        declared = file.inputs[0].shape[2:4]
        side = options.input_size_px
        height, width = (size or side or 0 for size in declared)
        if not (height and width):
            raise OptionError(
                f"'{file.path}' leaves its input size open; give the size that it was trained with "
                "as 'input_size_px'",
                "input_size_px",
            )
        return cls(layout, names, find_wanted_classes(names, options), (height, width), options)

    def prepare(self, image: UInt8[np.ndarray, "h w 3"]) -> Float[np.ndarray, "1 3 H W"]:
        """Resizes an RGB frame to the input size and normalizes it."""
        height, width = self.input_size
        scaled = cv2.resize(
            image.astype(np.float32) / 255, (width, height), interpolation=cv2.INTER_LINEAR
        )
        return np.ascontiguousarray(((scaled - MEAN) / STD).transpose(2, 0, 1)[None])

    def decode(
        self, outputs: Mapping[str, Float[np.ndarray, "..."]], frame_size: tuple[int, int]
    ) -> Detections:
        """Detections of a frame, best first. Raises WeightsError for shapes other than declared."""
        labels, planes = outputs[self.layout.labels], outputs[self.layout.masks]
        is_sound = labels.ndim == 3 and len(labels) == 1 and labels.shape[2] == len(self.names)
        if not is_sound or planes.ndim != 4 or planes.shape[:2] != labels.shape[:2]:
            raise WeightsError(
                f"the RF-DETR-seg model answered with labels {list(labels.shape)} and masks "
                f"{list(planes.shape)}, which is not what its file declares; export it again"
            )
        is_class = np.array([name is not None for name in self.names])
        scores = np.where(is_class, expit(labels[0]), -1.0)
        # A query counts under its best class, if that is wanted and reaches `confidence`.
        columns, best = scores.argmax(axis=1), scores.max(axis=1)
        order = np.argsort(-best, kind="stable")
        usable = (best >= self.options.confidence) & self.wanted[columns]
        queries = order[usable[order]][: self.options.max_detections]
        masks = resize_masks(planes[0][queries], frame_size, self.options.mask_threshold)
        return Detections.create(
            masks, [str(self.names[c]) for c in columns[queries]], best[queries]
        )


def name_columns(num_columns: int, found: Mapping[int, str]) -> tuple[str | None, ...]:
    """Name of every class column, None for columns that are no class (rules: module text)."""
    if not found and num_columns == len(_COCO_NAMES):
        return _COCO_NAMES
    if not found:
        return (*(f"class_{column}" for column in range(num_columns - 1)), None)
    return tuple(found.get(column) for column in range(num_columns))


def resize_masks(
    planes: Float[np.ndarray, "N mh mw"], frame_size: tuple[int, int], threshold: float
) -> Bool[np.ndarray, "N h w"]:
    """Mask logits, resized bilinearly to the frame and compared with the logit of `threshold`."""
    height, width = frame_size
    masks = np.zeros((len(planes), height, width), bool)
    for plane, mask in zip(planes, masks, strict=True):
        resized = cv2.resize(plane, (width, height), interpolation=cv2.INTER_LINEAR)
        np.greater_equal(resized, logit(threshold), out=mask)
    return masks
