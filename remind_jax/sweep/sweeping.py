"""`sweep`: thresholds by scenes, with features computed once and nothing done twice."""

from __future__ import annotations

import dataclasses
import hashlib
import importlib.metadata
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import jax
import numpy as np

from remind_jax.backbone.opening import open_backbone
from remind_jax.backbone.registry import Backbone
from remind_jax.config import Config, load_config
from remind_jax.config.static import Static
from remind_jax.errors import SweepError
from remind_jax.methods import DEFAULT_METHOD
from remind_jax.sources import Sampling, Source, open_source
from remind_jax.sweep.batches import plan_batch, run_batch, score_batch
from remind_jax.sweep.records import Records, Row, row_key
from remind_jax.sweep.result import SweepResult
from remind_jax.sweep.scene_arrays import (
    DESCRIPTION_SECTIONS,
    SceneFrames,
    describe_scene,
    load_scene,
)
from remind_jax.sweep.settings import Setting, Value, complete, grid

GIB = 1 << 30
_DEFAULT_BUDGET_GIB = 2.0


@dataclasses.dataclass(frozen=True)
class Progress:
    """How far a sweep is; handed to the caller's function after every batch."""

    scene: str
    num_done: int  # rows
    num_rows: int


def sweep(
    scenes: Any,
    settings: Mapping[str, Iterable[Value]] | Sequence[Mapping[str, Value]],
    *,
    config: str | Path | Config | Mapping[str, Any] = "default",
    backbone: str | Backbone = "patch-statistics",
    weights: str | Path | None = None,
    feature_cache: str | Path | None = None,
    sampling: Sampling | Mapping[str, Any] | None = None,
    memory_gib: float = _DEFAULT_BUDGET_GIB,
    batch: int | None = None,
    out: str | Path | None = None,
    progress: Callable[[Progress], None] | None = None,
    **source_options: Any,
) -> SweepResult:
    """Scores every setting on every scene; a row equals the single run with that setting.

    Args:
      scenes: One source with masks of known objects, or a list of them (`open_source`).
      settings: Values by threshold, all combinations of which are swept, or a list of settings
        (`settings.draw`, `settings.read_settings`).
      config: What a setting does not name.
      backbone: What patch features come from.
      weights: Converted weight file of the backbone.
      feature_cache: Folder of features that are kept and reused; none if left out.
      sampling: Which frames are processed.
      memory_gib: Memory that the compiled program may take.
      batch: Settings side by side; chosen by memory if left out.
      out: Folder that rows are written to as they come, and read from if they are there already.
      progress: Called after every batch.
      **source_options: Further options of `open_source`.

    Returns:
      The rows. After Ctrl-C, those so far, with `complete` false.

    Raises:
      RemindError: If a scene, a setting or the configuration is not accepted.
    """
    base = load_config(config)
    if base.tracker != DEFAULT_METHOD:
        raise SweepError(
            f"the configuration is for the tracker '{base.tracker}'; only 'remind' can be swept"
        )
    eyes = open_backbone(backbone, weights=weights, feature_cache=feature_cache)
    base = base.for_backbone(eyes.name)
    given = grid(settings) if isinstance(settings, Mapping) else list(settings)
    chosen = complete(given, base)
    sources = [
        open_source(scene, sampling=sampling, **source_options) for scene in _as_list(scenes)
    ]
    names = _distinct([source.name for source in sources])
    runner = _Runner(base, chosen, Records(out), memory_gib, batch, progress, len(sources))
    keys: list[list[str]] = []
    try:
        for name, source in zip(names, sources, strict=True):
            keys.append(runner.run(name, load_scene(source, _reading(base, chosen), eyes)))
        finished = True
    except KeyboardInterrupt:
        finished = False
    return runner.result(tuple(names), keys, finished)


class _Runner:
    """Runs what is missing of one scene after the other; capacities stay as far as they grew."""

    def __init__(
        self,
        config: Config,
        settings: list[Setting],
        records: Records,
        memory_gib: float,
        batch: int | None,
        progress: Callable[[Progress], None] | None,
        num_scenes: int,
    ) -> None:
        self._config, self._settings, self._records = config, settings, records
        self._static: Static = config.static
        self._budget_bytes = int(memory_gib * GIB)
        self._wanted_batch, self._progress = batch, progress
        self._num_rows, self._num_done = num_scenes * len(settings), 0
        self._batch, self._program_bytes = 0, 0

    def run(self, name: str, scene: SceneFrames) -> list[str]:
        """Runs all settings that have no row yet; the keys of all rows of the scene."""
        origin = {
            "config": self._config.to_dict(),
            "scene": _digest(scene),
            "version": importlib.metadata.version("remind-jax"),
        }
        keys = [row_key(name, setting, origin) for setting in self._settings]
        missing = [i for i, key in enumerate(keys) if key not in self._records]
        self._tell(name, len(keys) - len(missing))
        dim = scene.feats[0].patches.shape[-1]
        static = dataclasses.replace(self._static, feature_dim=dim)
        self._static = static.grow(num_detections=scene.most_detections)
        for group in _group_by_description([self._settings[i] for i in missing]):
            indices = [missing[i] for i in group]
            first = {"thresholds": _nested(self._settings[indices[0]])}
            frames = describe_scene(scene, self._static, self._config.updated(first).thresholds)
            for part in self._batches(frames, indices):
                settings = [self._settings[i] for i in part]
                answers, self._static = run_batch(
                    frames, self._config.thresholds, _filled(settings, self._batch), self._static
                )
                scores = score_batch(scene, answers, self._static)
                self._records.add(
                    Row(keys[i], name, self._settings[i], row)
                    for i, row in zip(part, scores, strict=False)
                )
                self._tell(name, len(part))
        return keys

    def result(self, names: tuple[str, ...], keys: list[list[str]], finished: bool) -> SweepResult:
        """The rows of settings that were run on all scenes."""
        done = len(keys) == len(names)
        rows = [
            tuple(self._records[of_scene[i]] for of_scene in keys)
            for i in range(len(self._settings) if done else 0)
        ]
        return SweepResult(
            settings=tuple(self._settings) if done else (),
            scenes=names,
            rows=tuple(rows),
            batch=self._batch,
            program_bytes=self._program_bytes,
            complete=finished,
        )

    def _batches(self, frames: Any, indices: list[int]) -> Iterator[list[int]]:
        if self._wanted_batch is not None:
            self._batch = self._wanted_batch
        elif not self._batch:
            self._batch, self._program_bytes = plan_batch(
                frames, self._config.thresholds, self._static, len(indices), self._budget_bytes
            )
        for first in range(0, len(indices), self._batch):
            yield indices[first : first + self._batch]

    def _tell(self, scene: str, num_rows: int) -> None:
        self._num_done += num_rows
        if self._progress is not None and num_rows:
            self._progress(Progress(scene, self._num_done, self._num_rows))


def _filled(settings: list[Setting], batch: int) -> list[Setting]:
    """The last setting again until the batch is full: one compiled program serves all batches."""
    return settings + settings[-1:] * (batch - len(settings))


def _group_by_description(settings: list[Setting]) -> list[list[int]]:
    """Indices of settings that share descriptors."""
    groups: dict[tuple, list[int]] = {}
    for index, setting in enumerate(settings):
        seen = [item for item in setting.items() if item[0].split(".")[0] in DESCRIPTION_SECTIONS]
        groups.setdefault(tuple(sorted(seen)), []).append(index)
    return list(groups.values())


def _nested(setting: Setting) -> dict[str, Any]:
    from remind_jax.config.dotted_keys import nest

    return nest(setting)


def _reading(config: Config, settings: list[Setting]) -> Config:
    """A configuration whose masks serve all settings: gaps as exact as any of them needs."""
    most = {}
    for name in ("scale_min_px", "exact_gap_max"):
        values = [s[f"relations.{name}"] for s in settings if f"relations.{name}" in s]
        values.append(getattr(config.thresholds.relations, name))
        most[name] = float(max(values))
    return config.updated({"thresholds": {"relations": most}})


def _digest(scene: SceneFrames) -> str:
    """Hash of all that the tracker is shown."""
    digest = hashlib.sha256()
    for leaf in jax.tree.leaves((scene.feats, scene.masks)):
        digest.update(np.ascontiguousarray(leaf).data)
    digest.update(np.ascontiguousarray(scene.truth.object_index).data)
    return digest.hexdigest()


def _as_list(scenes: Any) -> list[Any]:
    is_many = isinstance(scenes, (list, tuple)) and not isinstance(scenes, Source)
    found = list(scenes) if is_many else [scenes]
    if not found:
        raise SweepError("there are no scenes to sweep over; give at least one")
    return found


def _distinct(names: list[str]) -> list[str]:
    """Scene names, told apart by number where two are equal."""
    return [
        name if names.count(name) == 1 else f"{name} ({names[: i + 1].count(name)})"
        for i, name in enumerate(names)
    ]
