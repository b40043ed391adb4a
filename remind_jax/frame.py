"""What enters the tracker on the host: frames and the detections seen in them.

Letters: `H W` pixels of the frame, `N` detections, `Hp Wp` patches, `D` feature dimension.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np
import pycocotools.mask
from jaxtyping import Bool, Float, Int, UInt8

from remind_jax.decision import NO_ID, Outcome, Reason
from remind_jax.errors import SourceError
from remind_jax.printing.small_table import Printable, SmallTable
from remind_jax.printing.words import number

# Its stubs know neither bytes in `counts` nor lists of masks.
_coco: Any = pycocotools.mask

NO_INSTANCE = -1
Rle = dict[str, Any]  # COCO run-length encoding: {"size": [H, W], "counts": bytes}


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


@dataclasses.dataclass(frozen=True, repr=False)
class Tracks(Printable):
    """Identities of the detections of one frame, in detection order.

    Masks are kept run-length encoded, so that thousands of frames fit in memory.
    """

    frame_index: int  # processed frame, 0, 1, 2, ...
    source_index: int  # number in the source
    time_s: float
    name: str
    frame_size: tuple[int, int]  # height, width in pixels
    outcome: Int[np.ndarray, "N"]  # decision.Outcome
    reason: Int[np.ndarray, "N"]  # decision.Reason
    object_id: Int[np.ndarray, "N"]  # -1 without a firm identity
    pending_id: Int[np.ndarray, "N"]  # ambiguous or provisional track, -1 none
    status: Int[np.ndarray, "N"]  # decision.Status
    score: Float[np.ndarray, "N"]
    confidence: Float[np.ndarray, "N"]
    candidate_id: Int[np.ndarray, "N C"]  # what an undecided detection could be; -1 padding
    candidate_score: Float[np.ndarray, "N C"]
    labels: tuple[str, ...]  # class names
    boxes: Float[np.ndarray, "N 4"]  # left, top, right, bottom in pixels; right and bottom excluded
    areas: Int[np.ndarray, "N"]  # pixels
    detector_scores: Float[np.ndarray, "N"]
    instance_ids: Int[np.ndarray, "N"]  # ground truth where known, else -1
    rles: tuple[Rle, ...]

    def __len__(self) -> int:
        return len(self.labels)

    @property
    def masks(self) -> Bool[np.ndarray, "N H W"]:
        """Pixel masks, decoded anew at every call."""
        if not self.rles:
            return np.zeros((0, *self.frame_size), bool)
        return np.moveaxis(_coco.decode(list(self.rles)), -1, 0).astype(bool)

    @property
    def is_firm(self) -> Bool[np.ndarray, "N"]:
        """Detections that have one identity now (matched or new)."""
        return np.isin(self.outcome, [Outcome.MATCH, Outcome.NEW])

    def is_rated(self, row: int) -> bool:
        """Whether a detection has a score and a confidence.

        What was left out has neither, nor have new objects of trackers that rate only what they
        recognize, announced or not: their score is 0.
        """
        outcome = self.outcome[row]
        left_out = outcome in (Outcome.EMPTY, Outcome.UNASSIGNED, Outcome.DROPPED)
        may_be_new = outcome == Outcome.NEW or self.reason[row] == Reason.SEEN_TOO_FEW_TIMES
        return not left_out and (not may_be_new or float(self.score[row]) != 0)

    def shown_score(self, row: int) -> float | None:
        """The score to show; None where there is none or it is the confidence itself."""
        score = float(self.score[row])
        return score if self.is_rated(row) and score != float(self.confidence[row]) else None

    def shown_confidence(self, row: int) -> float | None:
        """The confidence to show; None where there is none."""
        return float(self.confidence[row]) if self.is_rated(row) else None

    def display_name(self, row: int) -> str:
        """What to write beside a detection: `cup 3`, `cup 3 or 5?`, `cup new?`."""
        label, object_id = self.labels[row], int(self.object_id[row])
        if object_id != NO_ID:
            return f"{label} {object_id}"
        shown = [str(i) for i in self.candidate_id[row] if i != NO_ID]
        if self.outcome[row] == Outcome.AMBIGUOUS and shown:
            return f"{label} {' or '.join(shown)}?"
        if self.outcome[row] == Outcome.PROVISIONAL_PARENT and shown:
            return f"{label} {shown[0]}?"
        return f"{label} new?"

    def _summarize(self) -> SmallTable:
        height, width = self.frame_size
        num = len(self)
        return SmallTable(
            f"frame {self.frame_index} ({self.time_s:.2f} s, {self.name}), {width} x {height}: "
            f"{num} detection{'' if num == 1 else 's'}",
            heads=("row", "name", "outcome", "confidence", "left", "top", "right", "bottom"),
            rows=[
                (
                    str(row),
                    self.display_name(row),
                    Outcome(int(self.outcome[row])).name.lower().replace("_", " "),
                    "" if (sure := self.shown_confidence(row)) is None else number(sure),
                    *(f"{side:.0f}" for side in self.boxes[row]),
                )
                for row in range(num)
            ],
            is_text=(1, 2),
        )
