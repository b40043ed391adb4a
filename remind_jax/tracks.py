"""What leaves the tracker on the host: the identities of one frame's detections.

Letters: `N` detections, `C` candidates shown per detection.
"""

from __future__ import annotations

import dataclasses
import numbers
import reprlib
from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
from hotcoco import mask as coco
from jaxtyping import Bool, Float, Int

from remind_jax.decision import NO_ID, Outcome, Reason
from remind_jax.errors import OutputError, SourceError
from remind_jax.frame import Rle
from remind_jax.printing.small_table import Printable, SmallTable
from remind_jax.printing.words import number

if TYPE_CHECKING:
    import supervision as sv


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
    names: Mapping[int, str] = dataclasses.field(default_factory=dict)  # given by people, by id
    # Of identities by id, as most of their detections are; that of the detection where it lacks.
    classes: Mapping[int, str] = dataclasses.field(default_factory=dict)

    def __len__(self) -> int:
        return len(self.labels)

    @property
    def masks(self) -> Bool[np.ndarray, "N H W"]:
        """Pixel masks, decoded anew at every call."""
        if not self.rles:
            return np.zeros((0, *self.frame_size), bool)
        return np.moveaxis(coco.decode(list(self.rles)), -1, 0).view(bool)

    @property
    def is_firm(self) -> Bool[np.ndarray, "N"]:
        """Detections that have one identity now (matched or new)."""
        return np.isin(self.outcome, [Outcome.MATCH, Outcome.NEW])

    def is_rated(self, row: int) -> bool:
        """Whether a detection has a score and a confidence.

        What was left out has neither, nor have new objects of trackers that rate only what they
        recognize, announced or not: their score is 0.
        """
        # Numbers of NumPy take long to be compared with an enumeration.
        outcome, reason = int(self.outcome[row]), int(self.reason[row])
        left_out = outcome in (Outcome.EMPTY, Outcome.UNASSIGNED, Outcome.DROPPED)
        may_be_new = outcome == Outcome.NEW or reason == Reason.SEEN_TOO_FEW_TIMES
        return not left_out and (not may_be_new or float(self.score[row]) != 0)

    def shown_score(self, row: int) -> float | None:
        """The score to show; None where there is none or it is the confidence itself."""
        score = float(self.score[row])
        return score if self.is_rated(row) and score != float(self.confidence[row]) else None

    def shown_confidence(self, row: int) -> float | None:
        """The confidence to show; None where there is none."""
        return float(self.confidence[row]) if self.is_rated(row) else None

    def display_name(self, row: int) -> str:
        """What to write beside a detection: `my cup`, `cup 3`, `cup 3 or 5?`, `cup new?`.

        Raises:
          SourceError: If there is no such row.
        """
        if not isinstance(row, numbers.Integral) or not -len(self) <= int(row) < len(self):
            raise SourceError(
                f"row {row!r} was asked for, but the frame has {len(self)} detections"
            )
        label, object_id = self.labels[row], int(self.object_id[row])
        if object_id != NO_ID:
            return title_of(self.classes.get(object_id, label), object_id, self.names)
        could_be = [int(one) for one in self.candidate_id[row] if one != NO_ID]
        if self.outcome[row] == Outcome.PROVISIONAL_PARENT:
            could_be = could_be[:1]
        if self.outcome[row] in (Outcome.AMBIGUOUS, Outcome.PROVISIONAL_PARENT) and could_be:
            if any(one in self.names for one in could_be):
                return f"{' or '.join(title_of(label, one, self.names) for one in could_be)}?"
            return f"{label} {' or '.join(map(str, could_be))}?"
        return label if self.outcome[row] == Outcome.DROPPED else f"{label} new?"

    def to_supervision(self, class_names: Sequence[str] | None = None) -> sv.Detections:
        """The detections for the `supervision` library, in their order.

        `tracker_id` is the identity, -1 while undecided; `confidence` is the detector's, the
        tracker's own is in `data["identity_confidence"]`, NaN where it has none;
        `data["class_name"]` are the classes and `data["display_name"]` what people read.

        Args:
          class_names: Names that `class_id` counts, the same for all frames, as
            `Tracker.class_names`; left out, those of this frame in order of first sight.

        Raises:
          OutputError: If supervision is not installed, or a class has no place among the names.
        """
        try:
            import supervision as sv
        except ImportError as error:
            raise OutputError(
                "to_supervision needs the supervision library, which is not installed: "
                'pip install "remind-jax[viz]"'
            ) from error
        if isinstance(class_names, str) or not isinstance(class_names, Iterable | None):
            kind = "one text, " if isinstance(class_names, str) else ""
            shown = reprlib.repr(class_names)
            raise OutputError(f"class names are {kind}{shown}; give a list of names")
        known = tuple(dict.fromkeys(self.labels if class_names is None else class_names))
        numbers = {name: number for number, name in enumerate(known)}
        if missing := sorted(set(self.labels) - set(numbers)):
            raise OutputError(
                f"class '{missing[0]}' is not among the {len(known)} class names; give all classes "
                "of the run"
            )
        return sv.Detections(
            xyxy=np.asarray(self.boxes, np.float32).reshape(-1, 4),
            mask=self.masks,
            confidence=np.asarray(self.detector_scores, np.float32),
            class_id=np.array([numbers[label] for label in self.labels], int),
            tracker_id=np.asarray(self.object_id, int),
            data={
                "class_name": np.array(self.labels, dtype=str),
                "display_name": np.array(
                    [self.display_name(row) for row in range(len(self))], dtype=str
                ),
                "outcome": np.array([Outcome(code).name.lower() for code in self.outcome], str),
                "identity_confidence": np.array(
                    [self.shown_confidence(row) for row in range(len(self))], np.float32
                ),
            },
        )

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


def title_of(label: str, object_id: int, names: Mapping[int, str]) -> str:
    """What an object is called: the name that people gave it, else its class and id."""
    return names.get(object_id) or f"{label} {object_id}"
