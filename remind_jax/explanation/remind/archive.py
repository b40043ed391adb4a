"""The account of a run on the host and in `trace.npz`: what each frame was decided on.

Rows of `decisions.*` and `detections.*` in the file are detections, of `sets.*` sets of objects, of
`context.*` and `frame.*` frames; `frame.sets` tells how many sets belong to each frame.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from remind_jax.decision import NO_ID, Decisions
from remind_jax.explanation.frame_archive import Columns, FrameArchive
from remind_jax.method import PAPER_METHOD, get_method
from remind_jax.remind.trace import (
    CandidateTrace,
    ContextTrace,
    DetectionTrace,
    PassTrace,
    SetTrace,
    Trace,
)

if TYPE_CHECKING:
    from remind_jax.explanation.remind.explain import Explainer
    from remind_jax.tracks import Tracks

TRACE_NAME = "trace.npz"

_NESTED: dict[str, type] = {"candidates": CandidateTrace, "passes": PassTrace}
_PER_FRAME = ("num_bad_patches",)  # the one field of `Decisions` that is not about a detection


@dataclasses.dataclass(frozen=True)
class FrameRecord:
    """Everything known about the decisions of one frame; NumPy arrays without padding rows."""

    frame_index: int
    decisions: Decisions
    detections: DetectionTrace
    sets: SetTrace
    context: ContextTrace

    def __len__(self) -> int:
        return len(self.decisions.outcome)

    @functools.cached_property
    def candidate_places(self) -> list[dict[int, int]]:
        """Column of each candidate shown, per detection, in the order shown."""
        return [
            {object_id: place for place, object_id in enumerate(row) if object_id != NO_ID}
            for row in np.asarray(self.detections.candidates.id).tolist()
        ]

    @functools.cached_property
    def set_members(self) -> list[tuple[tuple[int, ...], tuple[int, ...]]]:
        """Objects of each set and the detections that they explain."""
        explained = [tuple(np.flatnonzero(row).tolist()) for row in self.sets.detections]
        members = np.asarray(self.sets.member_id).tolist()
        ids = [tuple(i for i in row if i != NO_ID) for row in members]
        return list(zip(ids, explained, strict=True))


class TraceArchive(FrameArchive[FrameRecord]):
    """The records of a run of REMIND, and how its objects are called."""

    def __init__(self) -> None:
        super().__init__()
        self._labels: dict[int, str] = {}

    @property
    def labels(self) -> Mapping[int, str]:
        """Class name of every object that was known before some frame."""
        self._read()
        return self._labels

    def add(
        self,
        frame_index: int,
        num: int,
        decisions: Decisions,
        trace: Trace,
        class_names: Sequence[str],
    ) -> None:
        """Keeps one frame.

        Args:
          frame_index: Number of the processed frame.
          num: Detections of the frame; further rows are padding.
          decisions: Host arrays.
          trace: Host arrays.
          class_names: By class id.
        """
        for object_id, number in zip(trace.object_id, trace.object_class, strict=True):
            if object_id != NO_ID:
                self._labels.setdefault(int(object_id), class_names[int(number)])
        columns = {
            **_cut(_flatten(decisions, "decisions"), num),
            **_cut(_flatten(trace.detections, "detections"), num),
            **_trim_sets(_flatten(trace.sets, "sets"), num),
            **_flatten(trace.context, "context"),
        }
        self._frames[frame_index] = _as_record(frame_index, columns)

    def explainer(self, tracks: Sequence[Tracks], config: Mapping[str, Any]) -> Explainer:
        """Explains decisions of the run with these frames and this configuration."""
        from remind_jax.explanation.remind.explain import Explainer

        return Explainer(self, tracks, config)

    def _to_columns(self, frames: list[FrameRecord]) -> Columns:
        return {
            "frame.sets": np.array([len(frame.sets.score) for frame in frames], np.int32),
            "label.id": np.array(list(self._labels), np.int32),
            "label.name": np.array(list(self._labels.values()), dtype=np.str_),
            **_join([_columns_of(frame) for frame in frames]),
        }

    def _from_columns(self, columns: Mapping[str, np.ndarray]) -> dict[int, FrameRecord]:
        names = columns["label.id"].tolist(), columns["label.name"].tolist()
        self._labels = dict(zip(*names, strict=True))
        return {record.frame_index: record for record in _split(columns)}


def open_archive(run_dir: Path, tracker: str = PAPER_METHOD) -> Any:
    """The archive in the folder of a run of that tracker; None if it has none."""
    path = run_dir / TRACE_NAME
    return get_method(tracker).archive.open(path) if path.exists() else None


def _flatten(node: Any, path: str) -> Columns:
    """The arrays of nested dataclasses by dotted path."""
    if not dataclasses.is_dataclass(node):
        return {path: np.asarray(node)}
    columns: Columns = {}
    for field in dataclasses.fields(node):
        if field.name not in _PER_FRAME:
            columns |= _flatten(getattr(node, field.name), f"{path}.{field.name}")
    return columns


def _rebuild(kind: type, columns: Mapping[str, np.ndarray], path: str) -> Any:
    """Nested dataclasses from arrays by dotted path."""
    values: dict[str, Any] = {}
    for field in dataclasses.fields(kind):
        below = f"{path}.{field.name}"
        if field.name in _PER_FRAME:
            values[field.name] = np.int32(0)
        elif field.name in _NESTED:
            values[field.name] = _rebuild(_NESTED[field.name], columns, below)
        else:
            values[field.name] = columns[below]
    return kind(**values)


def _as_record(frame_index: int, columns: Mapping[str, np.ndarray]) -> FrameRecord:
    return FrameRecord(
        frame_index,
        _rebuild(Decisions, columns, "decisions"),
        _rebuild(DetectionTrace, columns, "detections"),
        _rebuild(SetTrace, columns, "sets"),
        _rebuild(ContextTrace, columns, "context"),
    )


def _columns_of(frame: FrameRecord) -> Columns:
    names = [field.name for field in dataclasses.fields(frame) if field.name != "frame_index"]
    return {
        path: column
        for name in names
        for path, column in _flatten(getattr(frame, name), name).items()
    }


def _cut(columns: Columns, num: int) -> Columns:
    return {path: column[:num] for path, column in columns.items()}


def _trim_sets(columns: Columns, num: int) -> Columns:
    """Without padding sets and padding detections."""
    rows = columns["sets.valid"]
    kept = {path: column[rows] for path, column in columns.items()}
    return kept | {
        "sets.detections": kept["sets.detections"][:, :num],
        "sets.member_id": kept["sets.member_id"][:, :num],
    }


def _join(frames: Sequence[Columns]) -> Columns:
    """Columns of all frames one after another."""
    if not frames:
        return {}
    joined = {}
    for path in frames[0]:
        parts = [frame[path] for frame in frames]
        if path.startswith("context."):
            joined[path] = np.stack(parts)
            continue
        if path.startswith("sets.") and parts[0].ndim == 2:
            width = max(part.shape[1] for part in parts)
            absent = NO_ID if path == "sets.member_id" else False
            parts = [
                np.pad(part, ((0, 0), (0, width - part.shape[1])), constant_values=absent)
                for part in parts
            ]
        joined[path] = np.concatenate(parts)
    return joined


def _split(columns: Mapping[str, np.ndarray]) -> Iterator[FrameRecord]:
    """The records of all frames."""
    counts = columns["frame.detections"], columns["frame.sets"]
    ends = [np.cumsum(count) for count in counts]
    by_rows = {"decisions": 0, "detections": 0, "sets": 1}
    for place, frame_index in enumerate(columns["frame.index"].tolist()):
        spans = [
            slice(int(end[place] - count[place]), int(end[place]))
            for end, count in zip(ends, counts, strict=True)
        ]
        num = int(counts[0][place])
        own: Columns = {}
        for path, column in columns.items():
            top = path.partition(".")[0]
            if top in by_rows:
                own[path] = column[spans[by_rows[top]]]
            elif top == "context":
                own[path] = column[place]
        own["sets.detections"] = own["sets.detections"][:, :num]
        own["sets.member_id"] = own["sets.member_id"][:, :num]
        yield _as_record(frame_index, own)
