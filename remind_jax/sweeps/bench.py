"""`sweep`, and the bench behind it: scenes that are read once, for sweep after sweep."""

from __future__ import annotations

import itertools
import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from remind_jax import __version__
from remind_jax.backbone.opening import open_backbone
from remind_jax.backbone.registry import Backbone
from remind_jax.compiled.method_code import code_of
from remind_jax.config import Config, load_config
from remind_jax.config.dotted_keys import flatten_fields
from remind_jax.errors import ConfigError, SweepError
from remind_jax.method import get_method
from remind_jax.session.delay import choose_delay
from remind_jax.settings.ranges import check_function, check_option
from remind_jax.sources import Sampling, Source, open_source
from remind_jax.sources.opening import check_options
from remind_jax.sweeps.cluster import Cluster
from remind_jax.sweeps.records import Records, Row, row_key
from remind_jax.sweeps.result import SweepResult
from remind_jax.sweeps.scene_arrays import SceneFrames, load_scene
from remind_jax.sweeps.settings import Setting, Value, as_settings, complete, complete_space
from remind_jax.sweeps.worker import Progress, Worker, group_by_description

DEFAULT_BUDGET_GIB = 2.0
MAX_GIB, MAX_BATCH, MAX_WORKERS = 1e5, 100_000, 10_000


class SceneBench:
    """Scenes on which settings are tried: read once, described once, scored on the device."""

    def __init__(
        self,
        scenes: Any,
        *,
        config: str | Path | Config | Mapping[str, Any] = "default",
        tracker: str | None = None,
        backbone: str | Backbone = "patch-statistics",
        weights: str | Path | None = None,
        feature_cache: str | Path | None = None,
        sampling: Sampling | Mapping[str, Any] | None = None,
        delay: int | None = None,
        memory_gib: float = DEFAULT_BUDGET_GIB,
        batch: int | None = None,
        out: str | Path | None = None,
        progress: Callable[[Progress], None] | None = None,
        workers: int | None = None,
        cluster: str | None = None,
        keep_scenes: bool = True,
        **source_options: Any,
    ) -> None:
        """Opens scenes; arguments are those of `sweep`.

        With `keep_scenes`, scenes stay in memory between sweeps.

        Raises:
          RemindError: If a scene or the configuration is not accepted.
        """
        check_options(source_options, type(self))
        check_option("memory_gib", memory_gib, 1e-3, MAX_GIB, whole=False)
        check_function("progress", progress)
        for name, value, most in (("batch", batch, MAX_BATCH), ("workers", workers, MAX_WORKERS)):
            if value is not None:
                check_option(name, value, 1, most)
        self._config = _choose(config, tracker)
        if (after := self._config.input.announce_after) > 1:
            raise ConfigError(
                f"input.announce_after is {after}, but a sweep scores every answer from the first "
                "detection on; set it to 1"
            )
        method = get_method(self._config.tracker)
        self._sweeping, self._delay = method.sweeping, choose_delay(delay, method)
        self._code = code_of(method)
        self._backbone = open_backbone(backbone, weights=weights, feature_cache=feature_cache)
        sources = [
            open_source(scene, sampling=sampling, **source_options) for scene in _as_list(scenes)
        ]
        names = _distinct([source.name for source in sources])
        self._sources: dict[str, Source] = dict(zip(names, sources, strict=True))
        self._records, self._progress = Records(out), progress
        self._keep_scenes = keep_scenes
        self._read: dict[str, SceneFrames] = {}
        self._reading: dict[str, float] = {}
        self._num_done = self._num_rows = 0  # of the sweep that goes on
        if workers is None and cluster is None:
            self._crew = Worker(self._config, memory_gib, batch, self._delay)
        else:
            self._crew = Cluster(
                self._config, memory_gib, batch, workers, cluster, delay=self._delay
            )

    @property
    def scenes(self) -> tuple[str, ...]:
        """Names of the scenes."""
        return tuple(self._sources)

    @property
    def tracker(self) -> str:
        """Name of the method whose thresholds settings are about."""
        return self._config.tracker

    def complete_space(self, space: Mapping[str, Iterable[Value]]) -> dict[str, list[Value]]:
        """What settings will be made of, checked (`settings.complete_space`)."""
        return complete_space(space, self._config)

    def find_fault(self, setting: Mapping[str, Value]) -> str:
        """Why a setting is not accepted, such as a least above its most; "" if it is."""
        try:
            complete([setting], self._config)
        except ConfigError as error:
            return str(error)
        return ""

    def run(self, settings: Sequence[Mapping[str, Value]]) -> SweepResult:
        """Scores every setting on every scene; what has a row already is not run again.

        Returns:
          The rows. After Ctrl-C, those so far, with `complete` false.

        Raises:
          RemindError: If a scene or a setting is not accepted.
        """
        chosen = complete(settings, self._config)
        self._sharpen(chosen)
        self._num_done, self._num_rows = 0, len(chosen) * len(self._sources)
        keys: list[list[str]] = []
        finished = False
        with self._records.locked():
            try:
                for name in self._sources:
                    keys.append(self._start(name, chosen))
                self._crew.finish()
                finished = True
            except KeyboardInterrupt:
                self._crew.stop()
        return self._collect(chosen, keys, finished)

    def _start(self, name: str, settings: Sequence[Setting]) -> list[str]:
        """Has the missing rows of a scene made; the keys of all of them."""
        scene = self._load(name)
        origin = {
            "config": scene.config.to_dict(),
            "delay": self._delay,
            "code": self._code,
            "scene": scene.digest,
            "version": __version__,
        }
        keys = [row_key(name, setting, origin) for setting in settings]
        missing = {key: i for i, key in enumerate(keys) if key not in self._records}
        self._tell(name, sum(key in self._records for key in keys))
        indices = list(missing.values())
        groups = group_by_description([settings[i] for i in indices], self._sweeping.described_by)

        def keep(rows: Iterable[int], scores: Iterable[dict[str, float]]) -> None:
            found = [
                Row(keys[i], name, settings[i], row) for i, row in zip(rows, scores, strict=True)
            ]
            self._records.add(found)
            self._tell(name, sum(keys.count(row.key) for row in found))

        if indices:
            jobs = [{indices[i]: settings[indices[i]] for i in group} for group in groups]
            self._crew.start(scene, jobs, keep)
        return keys

    def _tell(self, scene: str, num_rows: int) -> None:
        """Counts rows that are done, and reports them."""
        self._num_done += num_rows
        if self._progress is not None and num_rows:
            self._progress(Progress(scene, self._num_done, self._num_rows))

    def _collect(
        self, settings: list[Setting], keys: list[list[str]], finished: bool
    ) -> SweepResult:
        """The rows of settings that were run on all scenes."""
        reached_all = len(keys) == len(self._sources)
        done = [
            i
            for i in range(len(settings) if reached_all else 0)
            if all(of_scene[i] in self._records for of_scene in keys)
        ]
        return SweepResult(
            settings=tuple(settings[i] for i in done),
            scenes=self.scenes,
            rows=tuple(tuple(self._records[of_scene[i]] for of_scene in keys) for i in done),
            batch=self._crew.batch,
            program_bytes=self._crew.program_bytes,
            complete=finished,
        )

    def _load(self, name: str) -> SceneFrames:
        if name in self._read:
            return self._read[name]
        source = self._sources[name]
        scene = load_scene(source, self._config, self._backbone, self._reading)
        if self._keep_scenes:
            self._read[name] = scene
        return scene

    def _sharpen(self, settings: Sequence[Setting]) -> None:
        """Has masks read as exactly as the most demanding setting so far needs."""
        starts = (self._config, self._config.for_backbone(*self._backbone.identity))
        given: list[dict[str, Any]] = [dict(flatten_fields(one.thresholds)) for one in starts]
        reading = {}
        for name in self._sweeping.reduced_by:
            asked = [start | one for start in given for one in (self._reading, *settings)]
            reading[name] = max(float(one[name]) for one in asked)
        if reading != self._reading:
            self._read.clear()
            self._reading = reading


def sweep(
    scenes: Any,
    settings: Mapping[str, Iterable[Value]] | Sequence[Mapping[str, Value]],
    *,
    config: str | Path | Config | Mapping[str, Any] = "default",
    tracker: str | None = None,
    backbone: str | Backbone = "patch-statistics",
    weights: str | Path | None = None,
    feature_cache: str | Path | None = None,
    sampling: Sampling | Mapping[str, Any] | None = None,
    delay: int | None = None,
    memory_gib: float = DEFAULT_BUDGET_GIB,
    batch: int | None = None,
    out: str | Path | None = None,
    progress: Callable[[Progress], None] | None = None,
    workers: int | None = None,
    cluster: str | None = None,
    **source_options: Any,
) -> SweepResult:
    """Scores every setting on every scene; a row equals the scores of the run with that setting.

    Args:
      scenes: One source with masks of known objects, or a list of them (`open_source`).
      settings: Values by threshold, all combinations of which are swept, or a list of settings
        (`settings.draw`, `settings.read_settings`).
      config: What a setting does not name.
      tracker: Name of the method, with the thresholds of the configuration if it is its own, else
        the published ones.
      backbone: What patch features come from.
      weights: Converted weight file of the backbone.
      feature_cache: Folder of features that are kept and reused; none if left out.
      sampling: Which frames are processed.
      delay: Frames that answers wait, as in `run`; 0: what is answered at once is scored, as it is
        live.
      memory_gib: Memory that the compiled program may take, on each device.
      batch: Settings side by side; chosen by memory if left out.
      out: Folder that rows are written to as they come, and read from if they are there already.
      progress: Called after every batch.
      workers: Ray workers at the same time; this process does all if left out, with `cluster` all
        that the cluster has.
      cluster: Address of a running Ray cluster; with `workers` alone, one is started here.
      **source_options: Further options of `open_source`.

    Returns:
      The rows. After Ctrl-C, those so far, with `complete` false.

    Raises:
      RemindError: If a scene, a setting or the configuration is not accepted.
    """
    check_options(source_options, sweep)
    chosen = complete(as_settings(settings), _choose(config, tracker))
    bench = SceneBench(
        scenes,
        config=config,
        tracker=tracker,
        backbone=backbone,
        weights=weights,
        feature_cache=feature_cache,
        sampling=sampling,
        delay=delay,
        memory_gib=memory_gib,
        batch=batch,
        out=out,
        progress=progress,
        workers=workers,
        cluster=cluster,
        keep_scenes=False,
        **source_options,
    )
    return bench.run(chosen)


def _choose(config: str | Path | Config | Mapping[str, Any], tracker: str | None) -> Config:
    chosen = load_config(config)
    return chosen if tracker is None else chosen.with_tracker(tracker)


def _as_list(scenes: Any) -> list[Any]:
    is_many = isinstance(scenes, (list, tuple)) and not isinstance(scenes, Source)
    found = list(scenes) if is_many else [scenes]
    if not found:
        raise SweepError("there are no scenes to sweep over; give at least one")
    paths = [os.path.realpath(one) for one in found if isinstance(one, (str, Path))]
    twice = [path for path in paths if paths.count(path) > 1]
    if twice:  # cross-validation would choose by the scene that it holds out
        raise SweepError(f"'{twice[0]}' is given twice; give each scene once")
    return found


def _distinct(names: list[str]) -> list[str]:
    """Scene names, numbered where two are equal."""
    distinct: list[str] = []
    for name in names:
        numbered = (f"{name} ({number})" for number in itertools.count(1))
        tried = [name] if names.count(name) == 1 else []
        distinct.append(next(n for n in itertools.chain(tried, numbered) if n not in distinct))
    return distinct
