"""What enters the tracker on the host: frames and the detections seen in them.

Letters: `H W` pixels of the frame, `N` detections, `Hp Wp` patches, `D` feature dimension.
"""

from __future__ import annotations

import contextlib
import dataclasses
import numbers
import operator
import reprlib
import sys
from collections.abc import Mapping, Sequence, Set
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int, UInt8

from remind_jax.crops import Crops, require_room
from remind_jax.errors import SourceError, as_text, first_line, is_text
from remind_jax.files.host_array import host_array
from remind_jax.files.limits import MAX_LABEL, MAX_PIXELS, MAX_SIDE_PX

Rle = dict[str, Any]  # COCO run-length encoding: {"size": [H, W], "counts": bytes}

NO_INSTANCE = -1
UNTIMED_FPS = 10.0  # of frames that nobody gives a time, as trackers count them


@dataclasses.dataclass(frozen=True)
class Detections:
    """Instances seen in one frame, in detector order.

    `labels` are class names: evidence for the default; other trackers compare within a class only.
    `instance_ids` are ground truth (or -1) and never reach the tracker.
    """

    masks: Bool[np.ndarray, "N H W"] | Crops  # crops inside of a tracker
    labels: tuple[str, ...]
    scores: Float[np.ndarray, "N"]
    instance_ids: Int[np.ndarray, "N"]

    @classmethod
    def create(
        cls,
        masks: Any,
        labels: Sequence[str] | None = None,
        scores: Any = None,
        instance_ids: Any = None,
    ) -> Detections:
        """Builds detections from whatever is at hand; missing parts get neutral values.

        Args:
          masks: `[N, H, W]`, non-zero inside an instance.
          labels: Class name per mask, at most 200 characters; all `"object"` if left out.
          scores: Detector confidence per mask in [0, 1]; 1 if left out.
          instance_ids: True instance per mask; -1 if left out.

        Raises:
          SourceError: If a part is of another kind or range, the parts disagree about the number
            of detections, or there are more than 8,192.

        Example:
          >>> seen = Detections.create(np.ones((2, 4, 6)), labels=["mug", "bowl"])
          >>> seen.scores.tolist(), seen.instance_ids.tolist()
          ([1.0, 1.0], [-1, -1])
        """
        planes = masks if isinstance(masks, Crops) else as_masks(masks)
        num = len(planes)
        names = ("object",) * num if labels is None else _as_labels(labels)
        confidence = np.ones(num, np.float32) if scores is None else _as_scores(scores)
        ids = np.full(num, NO_INSTANCE, np.int32) if instance_ids is None else _as_ids(instance_ids)
        _check_lengths(num, labels=names, scores=confidence, instance_ids=ids)
        return cls(planes, names, confidence, ids)

    @classmethod
    def empty(cls, height_px: int, width_px: int) -> Detections:
        """A frame in which nothing was detected.

        Raises:
          SourceError: If a side is no number of pixels.
        """
        return cls.create(np.zeros((0, *check_size((height_px, width_px))), bool))

    def __len__(self) -> int:
        return len(self.labels)

    def select(self, keep: Any) -> Detections:
        """The detections at `keep` (indices or a boolean mask), in that order.

        Raises:
          SourceError: If there are no such detections.
        """
        try:
            keep = np.asarray(keep)
            rows = np.arange(len(self))[keep if keep.size else keep.astype(int)]
            if rows.ndim != 1:
                raise ValueError("they are no list")
        except (IndexError, ValueError, TypeError, OverflowError) as error:
            raise SourceError(
                f"of {len(self)} detections {reprlib.repr(keep)} cannot be selected "
                f"({first_line(error)}); give row numbers, or one truth value per detection"
            ) from error
        return Detections(
            self.masks[rows],
            tuple(self.labels[row] for row in rows),
            self.scores[rows],
            self.instance_ids[rows],
        )


@dataclasses.dataclass(frozen=True)
class Frame:
    """One processed frame of a source.

    `image` is missing in feature sequences, `features` and `detections` wherever the source has
    none; an empty `Detections` means that the source says that there is nothing.
    """

    index: int  # 0, 1, 2, ... over processed frames; `Tracker.update` numbers them by itself
    source_index: int  # number in the source, before sampling
    time_s: float  # presentation time from the start of the source
    name: str  # file name or frame number as text, for messages and outputs
    image: UInt8[np.ndarray, "H W 3"] | None = None  # RGB
    detections: Detections | None = None
    features: Float[np.ndarray, "Hp Wp D"] | None = None
    is_timed: bool = False  # by a clock; else `time_s` only numbers the frames

    def __post_init__(self) -> None:
        for name in ("image", "features"):  # maybe of another library
            values = getattr(self, name)
            if hasattr(values, "__array__") or hasattr(values, "__dlpack__"):
                values = host_array(values, f"the {name} of frame '{self.name}'")
                object.__setattr__(self, name, values)

    @property
    def size(self) -> tuple[int, int]:
        """Height and width in pixels.

        Raises:
          SourceError: If the frame holds neither an image nor masks.
        """
        if self.image is not None:
            return self.image.shape[0], self.image.shape[1]
        if self.detections is not None:
            return self.detections.masks.shape[1], self.detections.masks.shape[2]
        raise SourceError(f"frame '{self.name}' has neither an image nor masks")


def frame_of(picture: Any, index: int) -> Frame:
    """A frame of a live stream, which is numbered but has no name and no clock.

    Raises:
      SourceError: If it is no RGB image, uint8 `[H, W, 3]`.
    """
    image = host_array(picture, "pixels of the frame")
    check_image("the frame", image)
    return Frame(index, index, index / UNTIMED_FPS, str(index), image)


def check_size(frame_size: Any) -> tuple[int, int]:
    """Height and width of a frame that memory has room for.

    Raises:
      SourceError: If it is no such size.
    """
    try:
        height, width = (operator.index(side) for side in frame_size)
    except (TypeError, ValueError) as error:
        raise SourceError(
            f"the frame size is {reprlib.repr(frame_size)}; give height and width in whole pixels"
        ) from error
    sides_fit = 0 < min(height, width) <= max(height, width) <= MAX_SIDE_PX
    if not sides_fit or height * width > MAX_PIXELS:
        raise SourceError(
            f"frames of {width}x{height} pixels cannot be tracked; give sides from 1 to "
            f"{MAX_SIDE_PX}, and at most {MAX_PIXELS} pixels"
        )
    return height, width


def check_frame(frame: Any) -> None:
    """Checks a frame that may have been put together by hand.

    Raises:
      SourceError: If it is none, or a part is of another kind or shape.
    """
    if not isinstance(frame, Frame):
        raise SourceError(f"a frame is of type {type(frame).__name__}; give a remind_jax.Frame")
    is_timed = isinstance(frame.time_s, numbers.Real) and abs(frame.time_s) <= sys.float_info.max
    for name, fits, wanted in (
        ("index", isinstance(frame.index, numbers.Integral), "a whole number"),
        ("source_index", isinstance(frame.source_index, numbers.Integral), "a whole number"),
        ("time_s", is_timed, "a finite number of seconds"),
        ("name", isinstance(frame.name, str), "a text"),
    ):
        if not fits:
            shown = reprlib.repr(getattr(frame, name))
            raise SourceError(f"{name} of a frame is {shown}; it must be {wanted}")
    if frame.image is not None:
        check_image(f"the image of frame '{frame.name}'", frame.image)
        check_size(frame.image.shape[:2])
    if frame.features is not None:
        what = f"the features of frame '{frame.name}'"
        _check_array(what, frame.features, 3, "fV", "floats [rows, columns, width]")
        if 0 in frame.features.shape:
            raise SourceError(f"{what} are {frame.features.shape}; there is nothing to compare")
    if frame.detections is not None:
        check_detections(frame.detections, frame.name)


def check_detections(detections: Any, name: str) -> None:
    """Checks detections that may have been put together by hand, past `Detections.create`.

    Raises:
      SourceError: If they are none, a part is of another kind, or parts differ in length.
    """
    where = f" of frame '{name}'" if name else ""
    if not isinstance(detections, Detections):
        raise SourceError(
            f"detections{where} are of type {type(detections).__name__}; make them with "
            "remind_jax.Detections.create"
        )
    _check_array(f"masks{where}", detections.masks, 3, "b", "booleans [N, H, W]")
    num, labels = len(detections.masks), detections.labels
    require_room(num, detections.masks.shape[1:], f"what was given{where}")
    if not isinstance(labels, tuple) or not all(isinstance(label, str) for label in labels):
        raise SourceError(f"labels{where} are {reprlib.repr(labels)}; give a tuple of names")
    _check_array(f"scores{where}", detections.scores, 1, "f", "numbers [N]")
    _check_array(f"instance ids{where}", detections.instance_ids, 1, "iu", "whole numbers [N]")
    if not np.isfinite(detections.scores).all():
        raise SourceError(f"scores{where} are not all finite; give numbers from 0 to 1")
    ids = detections.instance_ids
    _check_lengths(num, where, labels=labels, scores=detections.scores, instance_ids=ids)


def _check_lengths(num: int, where: str = "", **parts: Any) -> None:
    for part, values in parts.items():
        if len(values) != num:
            raise SourceError(f"{len(values)} {part} were given for {num} masks{where}")


def check_image(what: str, image: Any) -> None:
    """Makes sure that it is an RGB image of bytes. Raises SourceError if it is none."""
    dtype, shape = getattr(image, "dtype", None), getattr(image, "shape", ())
    if dtype != np.uint8 or len(shape) != 3 or shape[2] != 3:
        found = type(image).__name__ if dtype is None else f"{dtype} of shape {shape}"
        raise SourceError(f"{what} is {found}; give an RGB image, uint8 [H, W, 3]")


def _check_array(what: str, array: Any, ndim: int, kinds: str, wanted: str) -> None:
    dtype = getattr(array, "dtype", None)
    if dtype is None or getattr(array, "ndim", None) != ndim or dtype.kind not in kinds:
        found = type(array).__name__ if dtype is None else f"{dtype} of shape {array.shape}"
        raise SourceError(f"{what}: found {found}, give {wanted}")


@dataclasses.dataclass(frozen=True)
class SkippedFrame:
    """What was left out of a sequence, and why."""

    name: str
    reason: str
    count: int = 1  # frames, where one cause took several

    def __post_init__(self) -> None:
        for field in ("name", "reason"):
            object.__setattr__(self, field, as_text(getattr(self, field)))


def as_masks(values: Any) -> Bool[np.ndarray, "N H W"]:
    """Masks of detections, booleans.

    Raises:
      SourceError: If they are no planes, not finite, negative, or probabilities: where masks end
        is for whoever made them to say.
      UnreadableFrame: If they are too many, or take more than is meant for a frame.
    """
    masks = _as_array("masks", values, "buif", 3, "one [H, W] plane per detection, [N, H, W]")
    require_room(len(masks), masks.shape[1:], "a frame")
    if masks.dtype.kind in "if" and masks.size:
        odd = masks[(np.floor(masks) != masks) | (masks < 0)]
        if odd.size:
            raise SourceError(
                f"masks hold {odd.flat[0]:g}, as of probabilities or logits; give booleans, for "
                "instance masks > 0.5"
            )
    return masks.astype(bool, copy=False)


def fill_boxes(boxes: Any, frame_size: tuple[int, int]) -> Bool[np.ndarray, "N H W"]:
    """Masks of boxes (left, top, right, bottom in pixels), cut off at the frame's border.

    Raises:
      SourceError: If they are no boxes, or a coordinate is not finite.
      UnreadableFrame: If they are too many, or take more than is meant for a frame.
    """
    array = host_array(boxes, "boxes")
    if array.size and (array.ndim != 2 or array.shape[1] != 4 or array.dtype.kind not in "uif"):
        raise SourceError(
            f"boxes are {array.dtype} {array.shape}; give left, top, right, bottom, [N, 4]"
        )
    corners = array.astype(np.float64).reshape(-1, 4)
    if not np.isfinite(corners).all():
        row = int(np.flatnonzero(~np.isfinite(corners).all(axis=1))[0])
        raise SourceError(f"box {row} is {corners[row].tolist()}; coordinates must be finite")
    require_room(len(corners), frame_size, "a frame")
    height, width = frame_size
    edges = np.clip(np.rint(corners), 0, [width, height, width, height]).astype(int)
    masks = np.zeros((len(edges), *frame_size), bool)
    for mask, (left, top, right, bottom) in zip(masks, edges.tolist(), strict=True):
        mask[top:bottom, left:right] = True
    return masks


def _as_array(
    name: str, values: Any, kinds: str, ndim: int = 1, wanted: str = "one number per mask, [N]"
) -> np.ndarray:
    """An array of finite numbers of these kinds."""
    array = host_array(values, name)
    if array.dtype.kind not in kinds and array.size:
        raise SourceError(f"{name} are {array.dtype}; give numbers")
    if array.dtype.kind == "f" and not np.isfinite(array).all():
        raise SourceError(f"{name} hold NaN or infinity; give finite numbers")
    if array.ndim != ndim:
        raise SourceError(f"{name} have shape {array.shape}; give {wanted}")
    return array


def _as_labels(labels: Any) -> tuple[str, ...]:
    names = None
    if not isinstance(labels, str | Set | Mapping):  # one name, or names without an order
        with contextlib.suppress(TypeError):
            names = tuple(labels)
    if names is None:
        shown = reprlib.repr(labels)
        raise SourceError(f"labels are {shown}; give one name per mask, in a list or tuple")
    for row, name in enumerate(names):
        if not isinstance(name, str):
            raise SourceError(f"label {row} is {name!r}; give the name of its class as text")
        if not is_text(name):
            raise SourceError(f"label {row} is {name[:40]!r}, which is no text in UTF-8; rename it")
        if not name.strip() or len(name) > MAX_LABEL:
            raise SourceError(
                f"label {row} has {len(name)} characters ({name[:40]!r}); give a name of 1 to "
                f"{MAX_LABEL} characters"
            )
    return tuple(str(name) for name in names)  # NumPy has a kind of text of its own


def _as_scores(scores: Any) -> Float[np.ndarray, "N"]:
    confidence = _as_array("scores", scores, "buif").astype(np.float32)
    outside = np.flatnonzero((confidence < 0) | (confidence > 1))
    if len(outside):
        row = int(outside[0])
        raise SourceError(f"score {row} is {confidence[row]:g}; give a confidence from 0 to 1")
    return confidence


def _as_ids(ids: Any) -> Int[np.ndarray, "N"]:
    numbers = _as_array("instance_ids", ids, "uif")
    is_sound = (np.abs(numbers.astype(float)) < 2**31) & (numbers.astype(float) % 1 == 0)
    if not is_sound.all():
        row = int(np.flatnonzero(~is_sound)[0])
        raise SourceError(f"instance id {row} is {numbers[row]}; give whole numbers of 32 bits")
    return numbers.astype(np.int32)
