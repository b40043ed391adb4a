"""What the files of a run may hold: the records of `detections.jsonl` and `run.json`."""

from __future__ import annotations

import dataclasses
import enum
import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Annotated, Any, Literal

import msgspec
import numpy as np
from msgspec import Meta

from remind_jax.decision import CODES, NO_ID, Outcome, Reason, Status
from remind_jax.errors import OutputError
from remind_jax.files.limits import MAX_FRAMES, MAX_INTEGER
from remind_jax.files.records import Count, Label, Side, Small, Text, Whole, check
from remind_jax.frame import SkippedFrame
from remind_jax.masks.run_length import find_malformed
from remind_jax.printing.small_table import Printable, SmallTable
from remind_jax.static import MOST_DETECTIONS
from remind_jax.tracks import Tracks, title_of

MAX_CANDIDATES = 1_000  # of a detection
_MAX_CELLS = 10_000_000  # detections times candidates: columns are padded to the widest

if TYPE_CHECKING:
    OutcomeName = ReasonName = StatusName = str
else:

    def _names(kind: type[enum.IntEnum]) -> Any:
        return Literal[tuple(code.name.lower() for code in kind)]

    OutcomeName, ReasonName, StatusName = _names(Outcome), _names(Reason), _names(Status)

FrameNumber = Annotated[int, Meta(ge=0, lt=MAX_FRAMES)]
Duration = Annotated[float, Meta(ge=0.0, le=1e12)]  # seconds or milliseconds

# Keys of a detection beside its codes, and the fields of `Tracks` that they are.
_NUMBERS = {
    "object_id": ("object_id", np.int32),
    "pending_id": ("pending_id", np.int32),
    "area": ("areas", np.int32),
    "instance_id": ("instance_ids", np.int32),
    "score": ("score", np.float64),
    "confidence": ("confidence", np.float64),
    "detector_score": ("detector_scores", np.float64),
}


class DetectionRow(msgspec.Struct, frozen=True):
    """One detection; numbers that were not finite are None."""

    label: Text
    outcome: OutcomeName
    reason: ReasonName
    status: StatusName
    object_id: Small
    pending_id: Small
    area: Count
    instance_id: Small
    score: float | None
    confidence: float | None
    detector_score: float | None
    candidates: Annotated[list[tuple[Small, float | None]], Meta(max_length=MAX_CANDIDATES)]
    box: tuple[float | None, float | None, float | None, float | None]
    rle: str


class FrameRow(msgspec.Struct, frozen=True):
    """One processed frame."""

    frame: FrameNumber
    source_index: Whole
    time_s: float | None
    name: Text
    size: tuple[Side, Side]  # height, width in pixels
    num_candidates: Annotated[int, Meta(ge=0, le=MAX_CANDIDATES)]
    detections: Annotated[list[DetectionRow], Meta(max_length=MOST_DETECTIONS)]


class StartRow(msgspec.Struct, frozen=True):
    """The first line of `detections.jsonl`."""

    format: Label = ""
    version: Count = 0
    info: msgspec.Raw = msgspec.Raw(b"{}")


class MemoryUse(msgspec.Struct, frozen=True):
    """What a memory holds, and what that takes."""

    objects: Count  # all that are known
    working_set: Count  # of these, in slots of the step
    at_rest: Count  # the others, on the host
    bytes: Annotated[int, Meta(ge=0, le=MAX_INTEGER)]  # of arrays; programs and pictures apart


class SummaryRecord(msgspec.Struct, frozen=True):
    """What is read of the summary in `run.json`."""

    frames: Count


class RunRecord(msgspec.Struct, frozen=True):
    """What is read of `run.json`; what it says further follows from the frames."""

    complete: bool
    info: RunInfo
    timings_ms: Annotated[
        dict[Label, Annotated[list[Duration], Meta(max_length=MAX_FRAMES)]],
        Meta(max_length=100),
    ]
    first_frame_ms: Duration | None
    compile_s: Duration | None
    skipped: Annotated[tuple[SkippedFrame, ...], Meta(max_length=MAX_FRAMES)]
    events: Annotated[tuple[Event, ...], Meta(max_length=MAX_FRAMES)]
    summary: SummaryRecord | None = None
    memory: MemoryUse | None = None
    comparison: Annotated[tuple[tuple[Label, Label, Label, Label], ...], Meta(max_length=100)] = ()


def tracks_to_json(tracks: Tracks) -> dict[str, Any]:
    """One frame as a dictionary that `json` can write; numbers that are not finite become null."""
    height, width = tracks.frame_size
    return {
        "frame": int(tracks.frame_index),
        "source_index": int(tracks.source_index),
        "time_s": _number(tracks.time_s),
        "name": tracks.name,
        "size": [int(height), int(width)],
        "num_candidates": int(tracks.candidate_id.shape[1]),
        "detections": [_detection_to_json(tracks, row) for row in range(len(tracks))],
    }


def _detection_to_json(tracks: Tracks, row: int) -> dict[str, Any]:
    shown = tracks.candidate_id[row] != NO_ID
    candidates = zip(
        tracks.candidate_id[row, shown].tolist(),
        map(_number, tracks.candidate_score[row, shown]),
        strict=True,
    )
    return {
        "label": tracks.labels[row],
        **{key: kind(getattr(tracks, key)[row]).name.lower() for key, kind in CODES.items()},
        **{key: _number(getattr(tracks, field)[row]) for key, (field, _) in _NUMBERS.items()},
        "candidates": [list(pair) for pair in candidates],
        "box": [_number(side) for side in tracks.boxes[row]],
        "rle": tracks.rles[row]["counts"].decode("ascii"),
    }


def _number(value: Any) -> float | int | None:
    """As `json` can write it; None if it is not finite."""
    number = value.item() if isinstance(value, np.generic) else value
    return number if math.isfinite(number) else None


def tracks_of(frame: FrameRow) -> Tracks:
    """The identities of a frame; scores are float64, padding candidates id -1 and score 0.

    Raises:
      OutputError: If its parts do not fit together, or a mask is damaged.
    """
    rows = frame.detections
    num, width = len(rows), frame.num_candidates
    if max((len(row.candidates) for row in rows), default=0) > width or num * width > _MAX_CELLS:
        raise OutputError(f"'num_candidates' is {width}, which does not fit the candidates")
    candidate_id = np.full((num, width), NO_ID, np.int32)
    candidate_score = np.zeros((num, width))
    for place, row in enumerate(rows):
        for column, (object_id, score) in enumerate(row.candidates):
            candidate_id[place, column] = object_id
            candidate_score[place, column] = np.nan if score is None else score
    try:
        rles = tuple({"size": [*frame.size], "counts": row.rle.encode("ascii")} for row in rows)
    except UnicodeEncodeError as error:
        raise OutputError("a mask is damaged: its code is no ASCII text") from error
    if (malformed := find_malformed(rles)) is not None:
        height, width = frame.size
        raise OutputError(
            f"the mask of detection {malformed} in frame {frame.frame} is damaged: its code is no "
            f"mask of {height} x {width} pixels (height x width)"
        )
    columns: dict[str, Any] = {
        key: np.array([kind[getattr(row, key).upper()] for row in rows], np.int32)
        for key, kind in CODES.items()
    }
    for key, (field, dtype) in _NUMBERS.items():
        columns[field] = np.array([getattr(row, key) for row in rows], dtype)
    return Tracks(
        frame_index=frame.frame,
        source_index=frame.source_index,
        time_s=frame.time_s,  # pyright: ignore[reportArgumentType] (as it was written)
        name=frame.name,
        frame_size=frame.size,
        candidate_id=candidate_id,
        candidate_score=candidate_score,
        labels=tuple(row.label for row in rows),
        boxes=np.array([row.box for row in rows], float).reshape(num, 4),
        rles=rles,
        **columns,
    )


@dataclasses.dataclass(frozen=True)
class KnownObject:
    """An object that a memory knows, or knew before the run."""

    object_id: Small
    label: Label  # class
    name: Label  # given by people; empty without one

    @property
    def title(self) -> str:
        """Its name, else class and id."""
        return title_of(self.label, self.object_id, {self.object_id: self.name})


@dataclasses.dataclass(frozen=True, repr=False)
class RunInfo(Printable):
    """What a run was made with: enough to read its outputs and to repeat it."""

    name: Text
    # what the source needs to be opened again; None if it cannot be
    source: dict[str, Any] | None
    frame_size: tuple[Side, Side]  # height, width in pixels
    fps: Annotated[float, Meta(ge=0.0, le=1e6)]  # processed frames per second
    class_names: Annotated[tuple[Text, ...], Meta(max_length=100_000)]
    config: dict[str, Any]  # nested, as it would be written to YAML
    backbone: Text
    # of remind_jax, jax, numpy, opencv, python
    versions: Annotated[dict[Label, Text], Meta(max_length=1_000)]
    device: Text
    started_at: Label  # ISO 8601
    detector: dict[str, Any] | None = None  # what found the detections; None for given masks
    # of the memory that the run went on from
    known_objects: Annotated[tuple[KnownObject, ...], Meta(max_length=1_000_000)] = ()
    # what else it was told, and what tells its features and an own tracker from others
    options: dict[str, Any] = dataclasses.field(default_factory=dict)
    # of its checkpoint, where people changed their names before it went on
    renamed: Annotated[tuple[KnownObject, ...], Meta(max_length=1_000_000)] = ()

    def __post_init__(self) -> None:
        if not isinstance(self.config.get("tracker"), str):
            raise ValueError("its `config` names no `tracker`")

    def to_json(self) -> dict[str, Any]:
        """The same as a dictionary that `json` can write."""
        return msgspec.to_builtins(self)

    @classmethod
    def from_json(cls, content: Mapping[str, Any]) -> RunInfo:
        """Reads back what `to_json` made; unknown keys of later versions are left out.

        Raises:
          OutputError: If a key is missing or of another kind.
        """
        return check(content, RunInfo, "the description of the run", refused=OutputError)

    @property
    def object_names(self) -> dict[int, str]:
        """Names that people gave to objects, by id."""
        told = {one.object_id: one.name for one in (*self.known_objects, *self.renamed)}
        return {object_id: name for object_id, name in told.items() if name}

    @property
    def tracker(self) -> str:
        """Name of the method."""
        return self.config["tracker"]

    def _summarize(self) -> SmallTable:
        return SmallTable(f"run '{self.name}'", self.facts())

    def facts(self) -> tuple[str, ...]:
        """What it was made with, in two lines."""
        height, width = self.frame_size
        return (
            f"{width} x {height} pixels, {self.fps:.4g} frames per second",
            f"tracker {self.tracker}, {self.backbone}, {self.device}, started at {self.started_at}",
        )


@dataclasses.dataclass(frozen=True)
class Event:
    """Something worth knowing that happened at a frame, as detections that were dropped."""

    frame_index: Annotated[int, Meta(ge=-1, lt=MAX_FRAMES)]  # -1: of the whole run
    kind: Label  # a word or two: "dropped", "features"
    message: Text
    # Ids that it is about; of what turned out to be another object both, that one last.
    objects: Annotated[tuple[Small, ...], Meta(max_length=MAX_FRAMES)] = ()
