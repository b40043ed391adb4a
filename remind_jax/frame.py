"""What enters the tracker on the host: frames and the detections seen in them.

Letters: `H W` pixels of the frame, `N` detections, `Hp Wp` patches, `D` feature dimension.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int, UInt8

from remind_jax.errors import SourceError

Rle = dict[str, Any]  # COCO run-length encoding: {"size": [H, W], "counts": bytes}

NO_INSTANCE = -1


@dataclasses.dataclass(frozen=True)
class Detections:
    """Instances seen in one frame, in detector order.

    `labels` are class names; a tracker compares a detection only with objects of its class.
    `instance_ids` are ground truth (or -1) and never reach the tracker.
    """

    masks: Bool[np.ndarray, "N H W"]
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
          labels: Class name per mask; all `"object"` if left out.
          scores: Detector confidence per mask in [0, 1]; 1 if left out.
          instance_ids: True instance per mask; -1 if left out.

        Raises:
          SourceError: If the parts disagree about the number of detections.

        Example:
          >>> seen = Detections.create(np.ones((2, 4, 6)), labels=["mug", "bowl"])
          >>> seen.scores.tolist(), seen.instance_ids.tolist()
          ([1.0, 1.0], [-1, -1])
        """
        masks = np.asarray(masks)
        if masks.ndim != 3:
            raise SourceError(
                f"masks have shape {masks.shape}; give one [H, W] plane per detection, [N, H, W]"
            )
        num = len(masks)
        if isinstance(labels, str):
            raise SourceError(f"labels are one text, {labels!r}; give one name per mask in a list")
        labels = ("object",) * num if labels is None else tuple(str(label) for label in labels)
        scores = np.ones(num, np.float32) if scores is None else np.asarray(scores, np.float32)
        ids = np.full(num, NO_INSTANCE) if instance_ids is None else np.asarray(instance_ids)
        for name, values in (("labels", labels), ("scores", scores), ("instance_ids", ids)):
            if len(values) != num:
                raise SourceError(f"{len(values)} {name} were given for {num} masks")
        return cls(masks.astype(bool, copy=False), labels, scores, ids.astype(np.int32))

    @classmethod
    def empty(cls, height_px: int, width_px: int) -> Detections:
        """A frame in which nothing was detected."""
        return cls.create(np.zeros((0, height_px, width_px), bool))

    def __len__(self) -> int:
        return len(self.labels)

    def select(self, keep: Any) -> Detections:
        """The detections at `keep` (indices or a boolean mask), in that order."""
        keep = np.asarray(keep)
        rows = np.arange(len(self))[keep if keep.size else keep.astype(int)]
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

    index: int  # 0, 1, 2, ... over processed frames; the tracker's clock
    source_index: int  # number in the source, before sampling
    time_s: float  # presentation time from the start of the source
    name: str  # file name or frame number as text, for messages and outputs
    image: UInt8[np.ndarray, "H W 3"] | None = None  # RGB
    detections: Detections | None = None
    features: Float[np.ndarray, "Hp Wp D"] | None = None

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


@dataclasses.dataclass(frozen=True)
class SkippedFrame:
    """What was left out of a sequence, and why."""

    name: str
    reason: str
    count: int = 1  # frames, where one cause took several
