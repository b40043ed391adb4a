"""`sweep`: thresholds by scenes, with features computed once and nothing done twice."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from remind_jax.backbone.registry import Backbone
from remind_jax.config import Config
from remind_jax.sources import Sampling
from remind_jax.sweeps.bench import DEFAULT_BUDGET_GIB, SceneBench
from remind_jax.sweeps.result import SweepResult
from remind_jax.sweeps.settings import Value, grid
from remind_jax.sweeps.worker import Progress


def sweep(
    scenes: Any,
    settings: Mapping[str, Iterable[Value]] | Sequence[Mapping[str, Value]],
    *,
    config: str | Path | Config | Mapping[str, Any] = "default",
    backbone: str | Backbone = "patch-statistics",
    weights: str | Path | None = None,
    feature_cache: str | Path | None = None,
    sampling: Sampling | Mapping[str, Any] | None = None,
    memory_gib: float = DEFAULT_BUDGET_GIB,
    batch: int | None = None,
    out: str | Path | None = None,
    progress: Callable[[Progress], None] | None = None,
    workers: int | None = None,
    cluster: str | None = None,
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
    bench = SceneBench(
        scenes,
        config=config,
        backbone=backbone,
        weights=weights,
        feature_cache=feature_cache,
        sampling=sampling,
        memory_gib=memory_gib,
        batch=batch,
        out=out,
        progress=progress,
        workers=workers,
        cluster=cluster,
        keep_scenes=False,
        **source_options,
    )
    return bench.run(grid(settings) if isinstance(settings, Mapping) else list(settings))
