"""From kept runs to scores: every run by the same rules, with metrics as they are today."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from remind_jax.benchmark.records import Record, folder_of
from remind_jax.benchmark.scenes import Scene
from remind_jax.errors import RemindError
from remind_jax.formats.rows import Row, TrackRows, collect_rows
from remind_jax.masks.run_length import encode_masks
from remind_jax.metrics.comparison import Interval
from remind_jax.metrics.evaluation import Evaluation, pool_evaluations, scene_intervals
from remind_jax.metrics.pairing import pair_scene
from remind_jax.metrics.run_evaluation import evaluate_pair
from remind_jax.metrics.run_folder import number_detections
from remind_jax.outputs.store import read_run
from remind_jax.sources.sampling import Sampling

MIN_SCENES = 5  # fewer say nothing about the spread between scenes
_RESAMPLED = ("IDF1", "HOTA", "AssA", "Recovery", "HardRecovery")


@dataclasses.dataclass(frozen=True)
class Scored:
    """A run and what it is worth; a failed run has no evaluation."""

    record: Record
    strict: Evaluation | None = None  # undecided detections carry no id
    settled: Evaluation | None = None  # undecided detections collapsed, as in the paper
    error: str = ""


def read_truth(scene: Scene, sampling: Sampling | None = None) -> TrackRows:
    """The annotations of a scene."""
    rows: list[Row] = []
    names: list[str] = []
    labels: dict[str, int] = {}
    for frame in scene.open(sampling):
        names.append(frame.name)
        found = frame.detections
        if found is None:
            continue
        rles = encode_masks(found.masks)
        for rle, label, instance in zip(rles, found.labels, found.instance_ids, strict=True):
            class_id = labels.setdefault(label, len(labels))
            rows.append((len(names) - 1, int(instance), class_id, rle, None))
    named = {"class_names": tuple(labels), "frame_names": tuple(names)}
    return collect_rows(scene.name, len(names), rows, **named)


def score_scene(
    out: Path, records: Sequence[Record], scene: Scene, sampling: Sampling | None = None
) -> list[Scored]:
    """Scores the runs on one scene; all have failed if its annotations cannot be read."""
    try:
        truth = read_truth(scene, sampling)
    except RemindError as error:  # a run with a detector has not read them
        return [Scored(record, error=record.error or str(error)) for record in records]
    return [score(out, record, truth) for record in records]


def score(out: Path, record: Record, truth: TrackRows) -> Scored:
    """Scores one run against the annotations of its scene."""
    if record.status != "done":
        return Scored(record, error=record.error)
    folder = folder_of(out, record.regime, record.contender, record.scene)
    try:
        _, tracks, _ = read_run(folder)
        paired = pair_scene(truth, number_detections(tracks, truth.name))
        strict, settled = (
            evaluate_pair(paired, tracks, undecided=how) for how in ("strict", "collapse")
        )
    except RemindError as error:
        return Scored(record, error=str(error))
    return Scored(record, strict, settled)


def summarize(runs: Sequence[Scored]) -> tuple[dict[str, float], dict[str, Interval]]:
    """Scores of one contender over scenes, and their bootstrap intervals over these scenes.

    Counts of scenes are added before ratios are taken; times are means over frames, memory is the
    largest of all scenes.
    """
    done = [run for run in runs if run.strict is not None and run.settled is not None]
    if not done:
        return {}, {}
    strict = [run.strict for run in done if run.strict is not None]
    settled = [run.settled for run in done if run.settled is not None]
    scores = pool_evaluations(strict).scores()
    scores["IDF1Settled"] = pool_evaluations(settled).scores()["IDF1"]
    scores["IDSWRate"] = scores["IDSW"] / max(1.0, scores["GT_Dets"])
    found = scene_intervals(strict) if len(strict) >= MIN_SCENES else {}
    intervals = {name: found[name] for name in _RESAMPLED if name in found}
    return scores | _resources([run.record for run in done]), intervals


def _resources(records: Sequence[Record]) -> dict[str, float]:
    pooled = {}
    for name in dict.fromkeys(name for record in records for name in record.times_ms):
        timed = [record for record in records if name in record.times_ms]
        times, weights = [r.times_ms[name] for r in timed], [r.num_frames for r in timed]
        pooled[name] = float(np.average(times, weights=weights))
    for name in ("peak_rss_mib", "device_mib"):
        known = [value for r in records if (value := getattr(r, name)) is not None]
        pooled[name] = max(known, default=math.nan)
    return pooled


def by_contender(runs: Sequence[Scored]) -> Mapping[str, list[Scored]]:
    """Runs of each contender, in order of first appearance."""
    grouped: dict[str, list[Scored]] = {}
    for run in runs:
        grouped.setdefault(run.record.contender, []).append(run)
    return grouped
