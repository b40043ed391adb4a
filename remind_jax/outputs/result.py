"""A finished (or interrupted) run: identities of every frame, and what they say together."""

from __future__ import annotations

import dataclasses
import functools
from collections import Counter
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec
import numpy as np

from remind_jax import files
from remind_jax.decision import NO_ID, Outcome
from remind_jax.errors import OutputError
from remind_jax.explanation.archive import TRACE_NAME, TraceArchive
from remind_jax.explanation.explainer import Explainer, open_archive
from remind_jax.explanation.explanation import Explanation
from remind_jax.files import as_path
from remind_jax.files.limits import MAX_FRAMES
from remind_jax.formats.firm import main_labels
from remind_jax.frame import SkippedFrame
from remind_jax.method import get_method
from remind_jax.outputs import store
from remind_jax.outputs.presence import MIN_ABSENCE_FRAMES, UNDECIDED, ObjectHistory, find_histories
from remind_jax.outputs.run_records import Event, KnownObject, MemoryUse, RunInfo
from remind_jax.printing.small_table import Printable, SmallTable
from remind_jax.settings.ranges import check_option
from remind_jax.tracks import Tracks

if TYPE_CHECKING:
    import pandas as pd
    import supervision as sv


COMPARISON_HEADS = ("measure", "found", "truth", "meaning")


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
    memory: MemoryUse | None = None  # at the end
    complete: bool = True  # False if the run was interrupted
    comparison: tuple[tuple[str, ...], ...] = ()  # with the truth: rows under `COMPARISON_HEADS`
    # What the decisions were made of, if that was kept.
    trace: TraceArchive | None = None

    def __len__(self) -> int:
        return len(self.tracks)

    def _summarize(self) -> SmallTable:
        facts, objects = self.summary(), self.objects()
        stopped = "" if self.complete else ", interrupted"
        odd = [event for event in self.events if event.kind == "features"]
        return SmallTable(
            f"run '{self.info.name}'{stopped}: {facts['frames']} frames, "
            f"{len(objects)} identities, {facts['returns']} returns, "
            f"{100 * facts['undecided_share']:.1f} % undecided",
            (*self.info.facts(), *(event.message for event in odd[:1])),
            ("identity", "first frame", "last frame", "frames seen", "returns"),
            [
                (
                    seen.title,
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
        check_option("min_absence_frames", min_absence_frames, 1, MAX_FRAMES)
        return find_histories(self.tracks, min_absence_frames)

    def not_met(self) -> tuple[KnownObject, ...]:
        """The objects that the memory knew before the run and that were not met in it."""
        met = {int(one) for tracks in self.tracks for one in tracks.object_id}
        names = self.info.object_names
        return tuple(
            dataclasses.replace(one, name=names.get(one.object_id, ""))
            for one in self.info.known_objects
            if one.object_id not in met
        )

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
            "known_objects": len(self.info.known_objects),
            "met_again": len(self.info.known_objects) - len(self.not_met()),
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
        table = pd.DataFrame(rows, columns=list(tables.CSV_COLUMNS))
        # Empty in a whole run, these would be objects.
        return table.astype(dict.fromkeys(("score", "confidence", "detector_score"), float))

    def to_supervision(self, t: int) -> sv.Detections:
        """The detections of the `t`-th processed frame for the `supervision` library.

        As `Tracks.to_supervision` has them; `class_id` counts `class_names`.

        Raises:
          OutputError: If supervision is not installed or the run has no such frame.
        """
        if not isinstance(t, (int, np.integer)) or not -len(self.tracks) <= int(t) < len(
            self.tracks
        ):
            raise OutputError(f"frame {t} was asked for, but the run has {len(self.tracks)} frames")
        return self.tracks[t].to_supervision(self.class_names)

    def explain(self, frame: int, detection: int) -> Explanation:
        """Why a detection became what it became; the run must have been made with `trace=True`.

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
        method = get_method(self.info.tracker)
        return method.explainer(self.trace, self.tracks, self.info.config)

    def save(self, run_dir: str | Path) -> None:
        """Writes what `load` reads: `detections.jsonl`, `run.json` and, with a trace, `trace.npz`.

        Raises:
          OutputError: If the folder cannot be made or written.
        """
        run_dir = files.as_path(run_dir, "the folder of the run", OutputError)
        files.make_folder(run_dir)
        with store.detections_writer(run_dir / store.DETECTIONS_NAME, self.info) as file:
            for tracks in self.tracks:
                file.add(tracks)
        self.save_trace(run_dir)
        self.save_run_json(run_dir)

    def save_trace(self, run_dir: str | Path) -> None:
        """Writes `trace.npz`, if there is a trace."""
        if self.trace is not None:
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
            "memory": None if self.memory is None else msgspec.to_builtins(self.memory),
            "skipped": [dataclasses.asdict(frame) for frame in self.skipped],
            "events": [dataclasses.asdict(event) for event in self.events],
            "comparison": self.comparison,
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
        run_dir = as_path(run_dir, "the folder of a run", OutputError)
        info, tracks, run = store.read_run(run_dir)
        shown = {
            "names": info.object_names,
            "classes": main_labels(tracks, [frame.object_id for frame in tracks]),
        }
        tracks = tuple(dataclasses.replace(frame, **shown) for frame in tracks)
        if run is not None and run.info.tracker != info.tracker:
            raise OutputError(
                f"'{run_dir}' holds parts of two runs: {store.RUN_NAME} is of tracker "
                f"'{run.info.tracker}', {store.DETECTIONS_NAME} of '{info.tracker}'; restore the "
                "folder, or run again"
            )
        trace = open_archive(run_dir, info.tracker)
        if run is None:
            return cls(tracks, info, complete=False, trace=trace)
        said = msgspec.structs.asdict(run)
        del said["summary"]
        return cls(tracks=tracks, trace=trace, **said)


def _count_repeated(tracks: Tracks) -> int:
    """Detections that share their identity with an earlier one of the same frame."""
    ids = tracks.object_id[tracks.object_id != NO_ID]
    return len(ids) - len(np.unique(ids))
