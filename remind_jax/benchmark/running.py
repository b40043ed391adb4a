"""Runs contenders on scenes: features once per scene, results kept as they come, nothing twice."""

from __future__ import annotations

import contextlib
import dataclasses
import hashlib
import json
import resource
import shutil
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Literal

import jax
import numpy as np

from remind_jax import __version__
from remind_jax.backbone.feature_cache import cache_features, default_folder
from remind_jax.backbone.registry import Backbone
from remind_jax.benchmark.contenders import Contender
from remind_jax.benchmark.records import Record, folder_of, read_record, write_record
from remind_jax.benchmark.scenes import Scene
from remind_jax.compiled.method_code import code_of
from remind_jax.detectors import DetectorOptions
from remind_jax.detectors.onnx_model import model_digest
from remind_jax.errors import RemindError, first_line
from remind_jax.masks.alignment import Alignment
from remind_jax.method import get_method
from remind_jax.outputs.result import Result
from remind_jax.outputs.store import DETECTIONS_NAME
from remind_jax.session.machine_memory import return_freed_memory
from remind_jax.session.run import run
from remind_jax.sources.sampling import Sampling

_KILLED = "the process ended during this run"
_MAX_KILLS = 2
_MIB = 1024 * 1024
_STATUS = Path("/proc/self/status")
_CLEAR = Path("/proc/self/clear_refs")
_RESET_PEAK = "5"  # see proc(5)
_TIMED_FRAMES = 12  # frames on which the backbone is timed, the first not counted


@dataclasses.dataclass(frozen=True)
class Setup:
    """What all contenders share."""

    out: Path
    backbone: Backbone
    detector: Path | None = None  # the scenes' own masks if left out
    detector_options: DetectorOptions | None = None
    sampling: Sampling = dataclasses.field(default_factory=Sampling)
    feature_cache: Path | None = None  # the user's cache folder if left out
    retry_failed: bool = False
    is_shown: bool = True  # how far each run is, where somebody looks on

    @property
    def regime(self) -> Literal["masks", "detector"]:
        """Where detections come from."""
        return "masks" if self.detector is None else "detector"


Report = Callable[[Record, bool], None]  # the record, and whether it was there already


def run_all(
    setup: Setup, scenes: tuple[Scene, ...], contenders: tuple[Contender, ...], report: Report
) -> list[Record]:
    """Runs what is not there yet, scene by scene, and gives all records.

    A run that fails is recorded as failed and the others go on.

    Raises:
      OutputError: If results cannot be kept.
      KeyboardInterrupt: If somebody stops it; the run in work is lost, all others are kept.
    """
    records = []
    detector = _describe_detector(setup)
    for scene in scenes:
        features_ms: float | None = None
        shown = [scene.name, scene.layout, scene.digest()]
        for contender in contenders:
            folder = folder_of(setup.out, setup.regime, contender.name, scene.name)
            fingerprint = _fingerprint(setup, contender, shown, detector)
            known = read_record(folder)
            is_known = (
                known is not None
                and known.fingerprint == fingerprint
                and (known.status == "failed" or (folder / DETECTIONS_NAME).exists())
            )
            num_kills = known.num_kills if known and is_known else 0
            is_tried_again = 0 < num_kills < _MAX_KILLS or (
                known is not None and setup.retry_failed and known.status == "failed"
            )
            if known and is_known and not is_tried_again:
                records.append(known)
                report(known, True)
                continue
            blank = Record(contender.name, scene.name, setup.regime, fingerprint, "failed")
            shutil.rmtree(folder, ignore_errors=True)
            # Stands if the process is killed, so that the next ones do not run into the same for
            # ever; once may have been chance.
            write_record(folder, dataclasses.replace(blank, error=_KILLED, num_kills=num_kills + 1))
            try:
                if features_ms is None:
                    features_ms = _prepare_features(setup, scene, contender)
                record = _run_one(setup, scene, contender, blank, features_ms)
            except KeyboardInterrupt:
                shutil.rmtree(folder, ignore_errors=True)
                raise
            except Exception as error:  # whatever it is, it is this run's failure
                kind = "" if isinstance(error, RemindError) else f"{type(error).__name__}: "
                record = dataclasses.replace(blank, error=kind + first_line(error))
            write_record(folder, record)
            records.append(record)
            report(record, False)
    return records


def _run_one(
    setup: Setup, scene: Scene, contender: Contender, blank: Record, features_ms: float
) -> Record:
    reset_peak()
    result = run(
        scene.open(setup.sampling, masks=setup.detector is None),
        detector=setup.detector,
        detector_options=setup.detector_options,
        backbone=_keep_features(setup),
        config=contender.config,
        delay=0,  # what a robot is told; and not every tracker revises answers
        progress=None if setup.is_shown else False,
    )
    peak_mib, device_mib = peak_rss_mib(), device_memory_mib()
    if not result.complete:
        raise KeyboardInterrupt
    result.save(folder_of(setup.out, setup.regime, contender.name, scene.name))
    # The first frame, and those in which a capacity grew, compiled.
    compiling = {*result.grown_at, *(tracks.frame_index for tracks in result.tracks[:1])}
    steady = [index not in compiling for index in range(len(result))]
    step_ms = np.sum([_stage(result, name) for name in ("observe", "step")], axis=0)
    frame_ms = features_ms + _stage(result, "detect") + _stage(result, "masks") + step_ms
    return dataclasses.replace(
        blank,
        status="done",
        num_frames=len(result),
        num_skipped=sum(frame.count for frame in result.skipped),
        times_ms=_mean_and_p95("frame", frame_ms[steady])
        | _mean_and_p95("compiling", frame_ms)
        | _mean_and_p95("step", step_ms[steady]),
        peak_rss_mib=peak_mib,
        device_mib=device_mib,
    )


def _stage(result: Result, name: str) -> np.ndarray:
    """Milliseconds of a stage in every frame; 0 where the run has no such stage."""
    times = result.timings_ms.get(name)
    return np.zeros(len(result)) if times is None else np.asarray(times, float)


def _mean_and_p95(stage: str, times_ms: np.ndarray) -> dict[str, float]:
    if not len(times_ms):
        return {}
    p95_ms = float(np.percentile(times_ms, 95))
    return {f"{stage}_ms": float(np.mean(times_ms)), f"{stage}_p95_ms": p95_ms}


def reset_peak() -> bool:
    """Starts the peak of resident memory anew; False where the system cannot: it only grows.

    What a compiler has freed, gigabytes, first goes back to the system.
    """
    return_freed_memory()
    with contextlib.suppress(OSError):
        _CLEAR.write_text(_RESET_PEAK)
        return True
    return False


def peak_rss_mib() -> float:
    """Largest resident memory since `reset_peak`, in MiB."""
    with contextlib.suppress(OSError, ValueError, IndexError):
        for line in _STATUS.read_text().splitlines():
            if line.startswith("VmHWM:"):
                return int(line.split()[1]) / 1024
    largest = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return largest / _MIB if sys.platform == "darwin" else largest / 1024


def device_memory_mib() -> float | None:
    """Most memory that arrays and programs took on the device so far, in MiB; None on the host."""
    stats = jax.local_devices()[0].memory_stats() or {}
    peak = stats.get("peak_bytes_in_use")
    return None if peak is None else peak / _MIB


def _prepare_features(setup: Setup, scene: Scene, contender: Contender) -> float:
    """Fills the cache for all contenders and times the backbone, in ms per frame."""
    cached, times, options = _keep_features(setup), [], contender.config.input
    for frame in scene.open(setup.sampling, masks=False):
        if frame.image is None:
            continue
        alignment = Alignment.fit(
            frame.size,
            setup.backbone.patch_px,
            max_width_px=options.max_width_px,
            center_crop=options.center_crop,
        )
        images = alignment.align_image(frame.image)[None]
        if len(times) < _TIMED_FRAMES:
            start = time.perf_counter()
            jax.block_until_ready(setup.backbone.extract(images))
            times.append(1000 * (time.perf_counter() - start))
        cached.extract(images)
    return float(np.median(times[1:] or times)) if times else 0.0


def _keep_features(setup: Setup) -> Backbone:
    return cache_features(setup.backbone, setup.feature_cache or default_folder())


def _fingerprint(
    setup: Setup, contender: Contender, shown: list[str], detector: list[str] | None
) -> str:
    """Changes with everything that may change the result, but for the program itself."""
    decisive = {
        "version": __version__,
        "config": contender.config.for_backbone(*setup.backbone.identity).to_dict(),
        "backbone": [setup.backbone.name, setup.backbone.fingerprint],
        "sampling": dataclasses.asdict(setup.sampling),
        "scene": shown,
        "detector": detector,
    }
    if code := code_of(get_method(contender.config.tracker)):
        decisive["code"] = code
    text = json.dumps(decisive, sort_keys=True, default=str)
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def _describe_detector(setup: Setup) -> list[str] | None:
    if setup.detector is None:
        return None
    return [model_digest(setup.detector), repr(setup.detector_options or DetectorOptions())]
