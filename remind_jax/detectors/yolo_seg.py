"""YOLO segmentation exports: heads of v8 and v11, and heads that suppress duplicates themselves.

Letters: `A` candidates (anchors), `C` classes, `M` mask prototypes, `mh mw` prototype grid (a
quarter of the input), `H W` network input, `h w` frame, `N` instances.

A v8 or v11 export has the outputs `[1, 4 + C + M, A]` (center x, center y, width, height in input
pixels; class scores in [0, 1]; mask coefficients) and `[1, M, mh, mw]`. Exports with suppression
inside (`nms=True`, and YOLO26 by default) have `[1, N, 6 + M]` instead (corners, score, class
index, coefficients). Which one a file is follows from these shapes alone.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence

import cv2
import numpy as np
from jaxtyping import Bool, Float, Int, UInt8
from scipy.special import logit

from remind_jax.detectors.exports import parse_literal, read_class_names
from remind_jax.detectors.onnx_model import MAX_INPUT_PX, Signature, TensorSpec
from remind_jax.detectors.options import DetectorOptions, find_wanted_classes
from remind_jax.errors import ConfigError, WeightsError
from remind_jax.frame import Detections
from remind_jax.masks.letterbox import Letterbox

KNOWN_SHAPES = "YOLO-seg [1, 4+C+M, A] with [1, M, mh, mw] or [1, N, 6+M] with [1, M, mh, mw]"
_MAX_SCORE = 1.05  # of quantized networks, which round
_DEFAULT_INPUT_PX = 640
_DEFAULT_STRIDE_PX = 32


@dataclasses.dataclass(frozen=True)
class YoloLayout:
    """Which output is which, and what its rows mean."""

    candidates: str  # output names
    prototypes: str
    num_coefficients: int
    num_classes: int | None  # None where rows hold a class index instead of scores
    suppressed: bool  # rows are final instances


@dataclasses.dataclass(frozen=True, eq=False)
class Candidates:
    """Boxes with one class each, not yet masks."""

    boxes: Float[np.ndarray, "N 4"]  # x0, y0, x1, y1 in input pixels
    scores: Float[np.ndarray, "N"]
    class_index: Int[np.ndarray, "N"]
    coefficients: Float[np.ndarray, "N M"]

    def select(self, rows: np.ndarray) -> Candidates:
        """The candidates at `rows` (indices or a boolean mask)."""
        return Candidates(
            self.boxes[rows], self.scores[rows], self.class_index[rows], self.coefficients[rows]
        )


def recognize_yolo_seg(outputs: Sequence[TensorSpec]) -> YoloLayout | None:
    """Reads the layout off the outputs' shapes; None if they are not YOLO-seg."""
    by_rank = {len(output.shape): output for output in outputs}
    if len(outputs) != 2 or set(by_rank) != {3, 4}:
        return None
    candidates, prototypes = by_rank[3], by_rank[4]
    _, rows, columns = candidates.shape
    num_coefficients = prototypes.shape[1]
    if num_coefficients is None:
        return None
    if columns == 6 + num_coefficients:
        return YoloLayout(candidates.name, prototypes.name, num_coefficients, None, True)
    if rows is None or rows <= 4 + num_coefficients:
        return None
    if columns is not None and columns < rows:
        return None  # YOLOv5 lists its candidates along the other axis, with one more value each
    num_classes = rows - 4 - num_coefficients
    return YoloLayout(candidates.name, prototypes.name, num_coefficients, num_classes, False)


@dataclasses.dataclass(frozen=True, eq=False)
class YoloSeg:
    """Turns frames into the network's input and its outputs into detections."""

    layout: YoloLayout
    names: tuple[str, ...]  # by class index
    wanted: Bool[np.ndarray, "C"]
    declared_size: tuple[int | None, int | None]  # of the input; None where left open
    long_side_px: int  # of inputs whose size is left open
    stride_px: int
    options: DetectorOptions

    kind = "yolo-seg"

    @classmethod
    def from_file(cls, file: Signature, layout: YoloLayout, options: DetectorOptions) -> YoloSeg:
        """Reads names, input size and stride. Raises ConfigError if options do not fit the file."""
        found = read_class_names(file.metadata)
        count = layout.num_classes or len(options.class_names or ()) or max(found, default=-1) + 1
        if options.class_names is not None and len(options.class_names) != count:
            raise ConfigError(
                f"{len(options.class_names)} class_names were given, "
                f"but '{file.path}' has {count} classes"
            )
        names = options.class_names or tuple(found.get(i, f"class_{i}") for i in range(count))
        return cls(
            layout,
            names,
            find_wanted_classes(names, options),
            (file.inputs[0].shape[2], file.inputs[0].shape[3]),
            options.input_size_px or _side_in(file, "imgsz", _DEFAULT_INPUT_PX),
            _side_in(file, "stride", _DEFAULT_STRIDE_PX),
            options,
        )

    def prepare(self, image: UInt8[np.ndarray, "h w 3"]) -> Float[np.ndarray, "1 3 H W"]:
        """Letterboxes an RGB frame and scales it to [0, 1]."""
        canvas = self.place((image.shape[0], image.shape[1])).apply(image)
        return cv2.dnn.blobFromImage(canvas, scalefactor=1 / 255)

    def place(self, frame_size: tuple[int, int]) -> Letterbox:
        """Where a frame of this size lies in the input."""
        declared, stride_px = self.declared_size, self.stride_px
        input_size = choose_input_size(frame_size, declared, self.long_side_px, stride_px)
        return Letterbox.fit(frame_size, input_size)

    def decode(
        self, outputs: Mapping[str, Float[np.ndarray, "..."]], frame_size: tuple[int, int]
    ) -> Detections:
        """Detections of a frame, best first. Raises WeightsError for shapes other than declared."""
        rows, prototypes = outputs[self.layout.candidates], outputs[self.layout.prototypes]
        self._check_shapes(rows, prototypes)
        options = self.options
        if self.layout.suppressed:
            found = read_suppressed_rows(rows[0], options.confidence)
            admitted = [options.admits(label) for label in self._label(found.class_index)]
            found = found.select(np.array(admitted, bool))
        else:
            found = read_candidates(rows[0], len(self.names), options.confidence, self.wanted)
            found = suppress_duplicates(found, options)
        best = np.argsort(-found.scores, kind="stable")[: options.max_detections]
        found = found.select(best)
        if (highest := found.scores.max(initial=0.0)) > _MAX_SCORE:
            raise WeightsError(
                f"the YOLO-seg model answered with a score of {highest:g}, and scores are at "
                "most 1; export it again"
            )
        masks = decode_masks(found, prototypes[0], self.place(frame_size), options.mask_threshold)
        labels = self._label(found.class_index)
        return Detections.create(masks, labels, np.minimum(found.scores, 1.0))

    def _label(self, class_index: Int[np.ndarray, "N"]) -> list[str]:
        """Class names; numbered ones for classes that the file does not name."""
        named = dict(enumerate(self.names))
        return [named.get(index, f"class_{index}") for index in class_index.tolist()]

    def _check_shapes(self, rows: np.ndarray, prototypes: np.ndarray) -> None:
        width = self.layout.num_coefficients
        axis, least = (2, 6 + width) if self.layout.suppressed else (1, 4 + len(self.names) + width)
        is_sound = rows.ndim == 3 and len(rows) == 1 and rows.shape[axis] == least
        if not is_sound or prototypes.ndim != 4 or prototypes.shape[1] != width:
            raise WeightsError(
                f"the YOLO-seg model answered with shapes {list(rows.shape)} and "
                f"{list(prototypes.shape)}, which is not what its file declares; export it again"
            )


def choose_input_size(
    frame_size: tuple[int, int],
    declared: tuple[int | None, int | None],
    long_side_px: int,
    stride_px: int,
) -> tuple[int, int]:
    """Height and width of the input: as declared, else the frame scaled to `long_side_px`.

    Sizes left open are rounded up to whole strides, so that bars are as thin as possible.
    """
    ratio = long_side_px / max(frame_size)
    height, width = (
        side or -(-max(1, round(length * ratio)) // stride_px) * stride_px
        for side, length in zip(declared, frame_size, strict=True)
    )
    return height, width


def read_candidates(
    rows: Float[np.ndarray, "F A"],
    num_classes: int,
    confidence: float,
    wanted: Bool[np.ndarray, "C"],
) -> Candidates:
    """Reads a v8 or v11 head: each candidate with its best class, if that is good and wanted."""
    scores = rows[4 : 4 + num_classes]
    class_index = scores.argmax(axis=0)
    best = scores.max(axis=0)
    usable = (best >= confidence) & wanted[class_index] & np.isfinite(rows[:4]).all(axis=0)
    kept = rows[:, usable].T
    half = kept[:, 2:4] / 2
    with np.errstate(over="ignore"):
        boxes = np.concatenate([kept[:, :2] - half, kept[:, :2] + half], axis=1)
    return Candidates(boxes, best[usable], class_index[usable], kept[:, 4 + num_classes :])


def read_suppressed_rows(rows: Float[np.ndarray, "N F"], confidence: float) -> Candidates:
    """Reads a head with suppression inside; rows of score 0 are padding."""
    usable = np.isfinite(rows[:, :6]).all(axis=1) & (rows[:, 4] >= max(confidence, 1e-6))
    kept = rows[usable]
    return Candidates(kept[:, :4], kept[:, 4], kept[:, 5].astype(int), kept[:, 6:])


def suppress_duplicates(candidates: Candidates, options: DetectorOptions) -> Candidates:
    """Non-maximum suppression, among candidates of one class unless `suppress_across_classes`."""
    if len(candidates.scores) == 0:
        return candidates
    # OpenCV keeps classes apart by shifting their boxes, which needs coordinates of 0 or more.
    origin = candidates.boxes[:, :2].min(axis=0)
    corners = candidates.boxes[:, :2] - origin
    sides = candidates.boxes[:, 2:] - candidates.boxes[:, :2]
    classes = candidates.class_index * (not options.suppress_across_classes)
    kept = cv2.dnn.NMSBoxesBatched(
        np.concatenate([corners, sides], axis=1).tolist(),
        candidates.scores.tolist(),
        classes.tolist(),
        score_threshold=0.0,
        nms_threshold=options.iou,
    )
    return candidates.select(np.asarray(kept, int).reshape(-1))


def decode_masks(
    candidates: Candidates,
    prototypes: Float[np.ndarray, "M mh mw"],
    letterbox: Letterbox,
    threshold: float,
) -> Bool[np.ndarray, "N h w"]:
    """Masks in the frame: coefficients times prototypes, brought to the frame, cut to the box.

    Logits are interpolated, as Ultralytics does, and compared with the logit of `threshold`. The
    way is: prototype grid to input, bars cut off, rest to the frame, each step bilinear and
    aligned at pixel centers. A pixel belongs to a box if its center does.
    """
    height, width = letterbox.frame_size
    masks = np.zeros((len(candidates.scores), height, width), bool)
    logits = np.tensordot(candidates.coefficients, prototypes, axes=1)
    bounds = np.ceil(letterbox.boxes_to_frame(candidates.boxes) - 0.5)
    corners = np.clip(bounds, 0, [width, height] * 2).astype(int).tolist()
    input_size = letterbox.input_size[::-1]
    for mask, of_mask, (x0, y0, x1, y1) in zip(masks, logits, corners, strict=True):
        plane = cv2.resize(of_mask, input_size, interpolation=cv2.INTER_LINEAR)
        box = slice(y0, y1), slice(x0, x1)
        mask[box] = letterbox.plane_to_frame(plane)[box] >= logit(threshold)
    return masks


def _side_in(file: Signature, key: str, default: int) -> int:
    """The largest side in the metadata, `[640, 640]` or `32`. Raises WeightsError if too large."""
    value = parse_literal(file.metadata.get(key, ""))
    values = value if isinstance(value, (list, tuple)) else [value]
    side = max((v for v in values if type(v) is int and v > 0), default=default)
    if side > MAX_INPUT_PX:
        raise WeightsError(
            f"'{file.path}' says {key} {side}; at most {MAX_INPUT_PX} is accepted, export it again"
        )
    return side
