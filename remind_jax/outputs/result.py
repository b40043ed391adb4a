"""A finished (or interrupted) run: identities of every frame, and what they say together.

Letters: `T` processed frames.
"""

from __future__ import annotations

import dataclasses
import functools
import itertools
from collections import Counter
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from remind_jax import files
from remind_jax.decision import NO_ID, Outcome
from remind_jax.errors import OutputError
from remind_jax.frame import SkippedFrame
from remind_jax.method import PAPER_METHOD, get_method
from remind_jax.outputs import store
from remind_jax.printing.small_table import Printable, SmallTable
from remind_jax.tracks import Tracks

if TYPE_CHECKING:
    import pandas as pd
    import supervision as sv

    from remind_jax.explanation.archive import TraceArchive
    from remind_jax.explanation.explainer import Explainer
    from remind_jax.explanation.explanation import Explanation

# Shorter gaps are flicker of detector or decision, not an absence worth a mark.
MIN_ABSENCE_FRAMES = 5

UNDECIDED = (Outcome.AMBIGUOUS, Outcome.PROVISIONAL_NEW, Outcome.PROVISIONAL_PARENT)


@dataclasses.dataclass(frozen=True, repr=False)
class RunInfo(Printable):
    """What a run was made with: enough to read its outputs and to repeat it."""

    name: str
    source: dict[str, Any] | None  # what the source needs to be opened again; None if it cannot be
    frame_size: tuple[int, int]  # height, width in pixels
    fps: float  # processed frames per second
    class_names: tuple[str, ...]
    config: dict[str, Any]  # nested, as it would be written to YAML
    backbone: str
    versions: dict[str, str]  # remind_jax, jax, numpy, opencv, python
    device: str
    started_at: str  # ISO 8601

    def to_json(self) -> dict[str, Any]:
        """The same as a dictionary that `json` can write."""
        return dataclasses.asdict(self) | {
            "frame_size": list(self.frame_size),
            "class_names": list(self.class_names),
        }

    @classmethod
    def from_json(cls, content: Mapping[str, Any]) -> RunInfo:
        """Reads back what `to_json` made; unknown keys of later versions are left out.

        Raises:
          OutputError: If a key is missing.
        """
        names = [field.name for field in dataclasses.fields(cls)]
        missing = [name for name in names if name not in content]
        if missing:
            raise OutputError(f"the description of the run lacks {', '.join(missing)}")
        values = {name: content[name] for name in names}
        height, width = values["frame_size"]
        values["frame_size"] = (int(height), int(width))
        values["class_names"] = tuple(values["class_names"])
        return cls(**values)

    def _summarize(self) -> SmallTable:
        return SmallTable(f"run '{self.name}'", self.facts())

    def facts(self) -> tuple[str, ...]:
        """What it was made with, in two lines."""
        height, width = self.frame_size
        used = [f"tracker {self.config['tracker']}"] if "tracker" in self.config else []
        return (
            f"{width} x {height} pixels, {self.fps:.4g} frames per second",
            ", ".join([*used, self.backbone, self.device, f"started at {self.started_at}"]),
        )


@dataclasses.dataclass(frozen=True)
class Event:
    """Something worth knowing that happened at a frame, as detections that were dropped."""

    frame_index: int
    kind: str  # a word or two: "dropped", "features"
    message: str


@dataclasses.dataclass(frozen=True)
class ObjectHistory:
    """When one identity was seen. Frame numbers are `Tracks.frame_index`."""

    object_id: int
    label: str
    first_frame: int
    last_frame: int
    num_frames: int  # frames with a firm detection
    absences: tuple[tuple[int, int], ...]  # first and last frame without it, both included
    returns: tuple[int, ...]  # the frame after each absence


@dataclasses.dataclass(frozen=True, repr=False)
class Result(Printable):
    """Everything a run found, in frame order."""

    tracks: tuple[Tracks, ...]
    info: RunInfo
    timings_ms: dict[str, list[float]] = dataclasses.field(default_factory=dict)  # by stage, [T]
    first_frame_ms: float | None = None  # from the first image to its identities
    compile_s: float | None = None  # waited for programs, in the whole run
    skipped: tuple[SkippedFrame, ...] = ()
    events: tuple[Event, ...] = ()
    grown_at: tuple[int, ...] = ()  # frames at which the memory got more room; not kept in files
    complete: bool = True  # False if the run was interrupted
    # What the decisions were made of, if that was kept.
    trace: TraceArchive | None = None

    def __len__(self) -> int:
        return len(self.tracks)

    def _summarize(self) -> SmallTable:
        told, objects = self.summary(), self.objects()
        stopped = "" if self.complete else ", interrupted"
        return SmallTable(
            f"run '{self.info.name}'{stopped}: {told['frames']} frames, {len(objects)} identities, "
            f"{told['returns']} returns, {100 * told['undecided_share']:.1f} % undecided",
            self.info.facts(),
            ("identity", "first frame", "last frame", "frames seen", "returns"),
            [
                (
                    f"{seen.label} {seen.object_id}",
                    str(seen.first_frame),
                    str(seen.last_frame),
                    str(seen.num_frames),
                    str(len(seen.returns)),
                )
                for seen in objects
            ],
        )

    @property
    def class_names(self) -> tuple[str, ...]:
        """Class names announced by the source, then others in order of first sight."""
        seen = (label for tracks in self.tracks for label in tracks.labels)
        return tuple(dict.fromkeys((*self.info.class_names, *seen)))

    def objects(self, min_absence_frames: int = MIN_ABSENCE_FRAMES) -> tuple[ObjectHistory, ...]:
        """Every identity by rising id, with the absences of at least `min_absence_frames`."""
        positions, labels = _firm_positions(self.tracks)
        frame_index = [tracks.frame_index for tracks in self.tracks]
        histories = []
        for object_id, seen in sorted(positions.items()):
            gaps = [
                (before + 1, after - 1)
                for before, after in itertools.pairwise(seen)
                if after - before - 1 >= min_absence_frames
            ]
            histories.append(
                ObjectHistory(
                    object_id=object_id,
                    label=labels[object_id],
                    first_frame=frame_index[seen[0]],
                    last_frame=frame_index[seen[-1]],
                    num_frames=len(seen),
                    absences=tuple((frame_index[a], frame_index[b]) for a, b in gaps),
                    returns=tuple(frame_index[b + 1] for _, b in gaps),
                )
            )
        return tuple(histories)

    def summary(self) -> dict[str, Any]:
        """Counts, shares of the outcomes and times, as `json` can write them."""
        outcomes = Counter(int(code) for tracks in self.tracks for code in tracks.outcome)
        num_detections = sum(outcomes.values())
        shares = {
            Outcome(code).name.lower(): outcomes[code] / num_detections for code in sorted(outcomes)
        }
        objects = self.objects()
        return {
            "frames": len(self.tracks),
            "skipped_frames": sum(frame.count for frame in self.skipped),
            "detections": num_detections,
            "identities": len(objects),
            "returns": sum(len(history.returns) for history in objects),
            "repeated_identities": sum(_count_repeated(tracks) for tracks in self.tracks),
            "outcome_shares": shares,
            "undecided_share": sum(outcomes[code] for code in UNDECIDED) / max(num_detections, 1),
            "ms_per_frame": {
                stage: {"median": float(np.median(ms)), "p95": float(np.percentile(ms, 95))}
                for stage, ms in self.timings_ms.items()
                if len(ms)
            },
            "first_frame_ms": self.first_frame_ms,
            "compile_s": self.compile_s,
        }

    def to_dataframe(self) -> pd.DataFrame:
        """One row per detection, with the columns of `tracks.csv`.

        Raises:
          OutputError: If pandas is not installed.
        """
        try:
            import pandas as pd
        except ImportError as error:
            raise OutputError(
                "to_dataframe needs pandas, which is not installed: pip install pandas"
            ) from error
        from remind_jax.outputs import tables

        rows = [row for tracks in self.tracks for row in tables.detection_rows(tracks)]
        return pd.DataFrame(rows, columns=list(tables.CSV_COLUMNS))

    def to_supervision(self, t: int) -> sv.Detections:
        """The detections of the `t`-th processed frame for the `supervision` library.

        `tracker_id` is the identity, -1 while undecided; `confidence` is the detector's, the
        tracker's own is in `data["identity_confidence"]`, NaN where it has none; `class_id`
        counts `class_names`.

        Raises:
          OutputError: If supervision is not installed or the run has no such frame.
        """
        try:
            import supervision as sv
        except ImportError as error:
            raise OutputError(
                "to_supervision needs the supervision library, which is not installed: "
                'pip install "remind-jax[viz]"'
            ) from error
        if not -len(self.tracks) <= t < len(self.tracks):
            raise OutputError(f"frame {t} was asked for, but the run has {len(self.tracks)} frames")
        tracks = self.tracks[t]
        numbers = {name: number for number, name in enumerate(self.class_names)}
        return sv.Detections(
            xyxy=np.asarray(tracks.boxes, np.float32).reshape(-1, 4),
            mask=tracks.masks,
            confidence=np.asarray(tracks.detector_scores, np.float32),
            class_id=np.array([numbers[label] for label in tracks.labels], int),
            tracker_id=np.asarray(tracks.object_id, int),
            data={
                "class_name": np.array(tracks.labels, dtype=str),
                "outcome": np.array([Outcome(code).name.lower() for code in tracks.outcome], str),
                "identity_confidence": np.array(
                    [tracks.shown_confidence(row) for row in range(len(tracks))], np.float32
                ),
            },
        )

    def explain(self, frame: int, detection: int) -> Explanation:
        """Why a detection became what it became; the run must have been made with `trace=True`.

        Args:
          frame: Number of the processed frame (`Tracks.frame_index`).
          detection: Row of the detection in its frame, from 0.

        Raises:
          OutputError: If the run holds no trace, or no such frame or detection.
        """
        if self.explainer is None:
            raise OutputError("the run holds no trace; run again with trace=True (or --trace)")
        return self.explainer.explain(frame, detection)

    @functools.cached_property
    def explainer(self) -> Explainer | None:
        """Explains any number of decisions; None if the run holds no trace."""
        if self.trace is None:
            return None
        method = get_method(self.info.config.get("tracker", PAPER_METHOD))
        return method.explainer(self.trace, self.tracks, self.info.config)

    def save(self, run_dir: str | Path) -> None:
        """Writes what `load` reads: `detections.jsonl`, `run.json` and, with a trace, `trace.npz`.

        Raises:
          OutputError: If the folder cannot be made or written.
        """
        run_dir = Path(run_dir)
        files.make_folder(run_dir)
        with store.DetectionsWriter(run_dir / store.DETECTIONS_NAME, self.info.to_json()) as file:
            for tracks in self.tracks:
                file.add(tracks)
        self.save_trace(run_dir)
        self.save_run_json(run_dir)

    def save_trace(self, run_dir: str | Path) -> None:
        """Writes `trace.npz`, if there is a trace."""
        if self.trace is not None:
            from remind_jax.explanation.archive import TRACE_NAME

            self.trace.save(Path(run_dir) / TRACE_NAME)

    def save_run_json(self, run_dir: str | Path) -> None:
        """Writes `run.json`: configuration, versions, counts, times, what went wrong."""
        content = {
            "format": "remind-jax run",
            "version": store.VERSION,
            "complete": self.complete,
            "info": self.info.to_json(),
            "summary": self.summary(),
            "first_frame_ms": self.first_frame_ms,
            "compile_s": self.compile_s,
            "skipped": [dataclasses.asdict(frame) for frame in self.skipped],
            "events": [dataclasses.asdict(event) for event in self.events],
            "timings_ms": {
                stage: [round(float(ms), 3) for ms in times]
                for stage, times in self.timings_ms.items()
            },
        }
        store.write_run_json(Path(run_dir) / store.RUN_NAME, content)

    @classmethod
    def load(cls, run_dir: str | Path) -> Result:
        """Opens the output directory of a run, interrupted ones included.

        Raises:
          OutputError: If the folder holds no run or the run is damaged.
        """
        from remind_jax.explanation.explainer import open_archive

        run_dir = Path(run_dir)
        info, tracks = store.read_detections(run_dir / store.DETECTIONS_NAME)
        config = RunInfo.from_json(info).config
        trace = open_archive(run_dir, config.get("tracker", PAPER_METHOD))
        run = store.read_run_json(run_dir / store.RUN_NAME)
        if run is None:
            return cls(tracks, RunInfo.from_json(info), complete=False, trace=trace)
        return cls(
            tracks=tracks,
            info=RunInfo.from_json(run.get("info", info)),
            timings_ms=run.get("timings_ms", {}),
            first_frame_ms=run.get("first_frame_ms"),
            compile_s=run.get("compile_s"),
            skipped=tuple(SkippedFrame(**frame) for frame in run.get("skipped", ())),
            events=tuple(Event(**event) for event in run.get("events", ())),
            complete=bool(run.get("complete", False)),
            trace=trace,
        )


def _firm_positions(tracks: Iterable[Tracks]) -> tuple[dict[int, list[int]], dict[int, str]]:
    """Positions in the run at which each identity was seen, and its class name."""
    positions: dict[int, list[int]] = {}
    labels: dict[int, str] = {}
    for position, frame in enumerate(tracks):
        for object_id, label in zip(frame.object_id.tolist(), frame.labels, strict=True):
            if object_id == NO_ID:
                continue
            seen = positions.setdefault(object_id, [])
            if not seen or seen[-1] != position:
                seen.append(position)
            labels.setdefault(object_id, label)
    return positions, labels


def _count_repeated(tracks: Tracks) -> int:
    """Detections that share their identity with an earlier one of the same frame."""
    ids = tracks.object_id[tracks.object_id != NO_ID]
    return len(ids) - len(np.unique(ids))
