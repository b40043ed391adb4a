"""What a frame becomes on the host, before anything is decided: aligned, reduced, observed."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Mapping
from typing import Any

import numpy as np
from jaxtyping import Bool

from remind_jax.config import Config
from remind_jax.crops import Crops
from remind_jax.errors import SourceError
from remind_jax.frame import Detections, Frame
from remind_jax.masks.alignment import Alignment
from remind_jax.masks.closeups import Closeups, cut_closeups
from remind_jax.masks.doubles import find_doubles
from remind_jax.masks.reduction import reduce_masks
from remind_jax.method import Method
from remind_jax.observation import Masks

ANY_CLASS = "thing"  # class of all detections where classes are not to be compared


@dataclasses.dataclass(frozen=True)
class Prepared:
    """A frame as the device needs it, and what the result will repeat of it."""

    frame: Frame
    detections: Detections  # without ignored classes, in pixels of the frame
    image: np.ndarray | None  # uint8 RGB at the tracker's size, in steady light, or
    features: np.ndarray | None  # patch features that came with the frame
    masks: Masks  # one slot per detection
    num_ignored: int  # detections of ignored classes
    is_double: Bool[np.ndarray, "N"]  # second detections of one thing, which are not decided about
    stage_ms: dict[str, float]
    class_ids: Mapping[str, int]  # numbers of classes, of the preparer that made it
    closeups: Closeups | None = None  # of the detections, where these are described
    observed: Any = None  # what the method observed between the last frame and this one


class FramePreparer:
    """Prepares the frames of one stream, in order; knows their classes, but no memory.

    Attributes:
      class_ids: Number of each class met so far, by name; of all in one where none are compared.
      labels: Classes met so far, by their names, in that order.
      last_image: Of the last frame prepared, if the method observes images.
      last_time_s: Of the last frame, if that was measured.
    """

    def __init__(self, method: Method, patch_px: int, with_closeups: bool = False) -> None:
        """`patch_px` is the side of a patch of frames that bring no features of their own."""
        self._method, self._patch_px, self._with_closeups = method, patch_px, with_closeups
        self.class_ids: dict[str, int] = {}
        self.labels: dict[str, None] = {}
        self.last_image: np.ndarray | None = None
        self.last_time_s: float | None = None
        steady_light = method.needs.steady_light
        self._light = None if steady_light is None else steady_light()

    def prepare(self, frame: Frame, config: Config) -> Prepared:
        """Aligns frame and wanted masks to whole patches, and reduces these (`Tracker.prepare`)."""
        start = time.perf_counter()
        detections, num_ignored = _wanted_detections(frame, config)
        alignment = self._align(frame, config)
        options = config.input
        gaps: dict[str, Any] = {"exact_gap_max": None}
        if self._method.needs.gap_options is not None:
            gaps = self._method.needs.gap_options(config.thresholds)
        masks = alignment.align_masks(detections.masks)
        classes = (ANY_CLASS,) * len(detections) if options.class_agnostic else detections.labels
        known = self.class_ids
        self.labels |= dict.fromkeys(detections.labels)
        reduced = reduce_masks(
            masks,
            np.array([known.setdefault(name, len(known)) for name in classes], np.int32),
            detections.scores,
            num_slots=len(detections),
            patch_px=self._patch_px_of(frame),
            sanitize=options.sanitize,
            fill_holes=options.fill_holes,
            close_px=options.close_px,
            open_px=options.open_px,
            keep_largest=options.keep_largest,
            erosion_px=options.erosion_px,
            **gaps,
        )
        is_double = find_doubles(
            Crops.of(detections.masks), classes, detections.scores, options.double_overlap
        )
        reduced = dataclasses.replace(reduced, valid=reduced.valid & ~is_double)
        image = None if frame.image is None else alignment.align_image(frame.image)
        reduced_at = time.perf_counter()
        observed = self._observe(image, frame)
        observed_at = time.perf_counter()
        if self._light is not None and image is not None:
            image = self._light.steady(image)
        closeups = None
        if self._with_closeups and image is not None and frame.features is None:
            eroded = masks.eroded(options.erosion_px, margin_px=0)
            closeups = cut_closeups(image, eroded, self._patch_px)
        observe_s = observed_at - reduced_at
        spent = {"masks": 1000 * (time.perf_counter() - start - observe_s)}
        if self._method.needs.observe is not None:
            spent["observe"] = 1000 * observe_s
        return Prepared(
            frame=frame,
            detections=detections,
            image=image,
            features=frame.features,
            masks=reduced,
            num_ignored=num_ignored,
            is_double=is_double,
            stage_ms=spent,
            class_ids=known,
            closeups=closeups,
            observed=observed,
        )

    def pass_over(self, frame: Frame, config: Config) -> None:
        """Keeps of a frame, which is not prepared, what the next one needs.

        Raises:
          SourceError: If the frame is smaller than a patch.
        """
        if self._method.needs.observe is None:
            return
        alignment = self._align(frame, config)
        self._observe(None if frame.image is None else alignment.align_image(frame.image), frame)

    def _observe(self, image: np.ndarray | None, frame: Frame) -> Any:
        """What the method observes from the last image to this one, which becomes the last one."""
        if self._method.needs.observe is None:
            return None
        observed = self._method.needs.observe(self.last_image, image, self._elapse(frame))
        # A copy: cameras give one buffer again and again.
        self.last_image = None if image is None else image.copy()
        if self._light is not None:
            self._light.follow(image, observed)
        return observed

    def _elapse(self, frame: Frame) -> float | None:
        """Seconds since the last frame; None if no clock tells, or one that stands or goes back."""
        last_s, now_s = self.last_time_s, frame.time_s if frame.is_timed else None
        self.last_time_s = now_s
        return None if last_s is None or now_s is None or now_s <= last_s else now_s - last_s

    def _align(self, frame: Frame, config: Config) -> Alignment:
        """How the frame becomes whole patches."""
        return Alignment.fit(
            frame.size,
            self._patch_px_of(frame),
            # Features that a frame brings cannot be scaled with it.
            max_width_px=config.input.max_width_px if frame.features is None else frame.size[1],
            center_crop=config.input.center_crop,
        )

    def _patch_px_of(self, frame: Frame) -> int:
        """Side of a patch in pixels, also of a frame that brings its own features."""
        if frame.features is None:
            return self._patch_px
        (height, width), (rows, columns) = frame.size, frame.features.shape[:2]
        patch_px = height // rows
        if patch_px < 1 or (height // patch_px, width // patch_px) != (rows, columns):
            raise SourceError(
                f"features of frame '{frame.name}' are {rows}x{columns} patches, which do not "
                f"tile its {height}x{width} pixels with square patches"
            )
        return patch_px


def _wanted_detections(frame: Frame, config: Config) -> tuple[Detections, int]:
    """The detections of the frame but for those of ignored classes, and how many these are."""
    if frame.detections is None:
        raise SourceError(f"frame '{frame.name}' comes without masks; give masks or a detector")
    masks = frame.detections.masks
    if frame.image is not None and frame.image.shape[:2] != masks.shape[1:]:
        raise SourceError(
            f"masks of frame '{frame.name}' are {masks.shape[2]}x{masks.shape[1]} pixels, the "
            f"image is {frame.image.shape[1]}x{frame.image.shape[0]}"
        )
    ignored = {name.lower() for name in config.input.ignored_classes}
    labels = frame.detections.labels
    kept = [row for row, name in enumerate(labels) if name.lower() not in ignored]
    detections = frame.detections
    # So that planes are read once, and the caller's not kept.
    detections = dataclasses.replace(detections, masks=Crops.of(masks))
    return detections.select(np.array(kept, int)), len(labels) - len(kept)
