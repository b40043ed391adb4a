"""Runs settings on a scene, in this process and on all its devices."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import jax
import numpy as np

from remind_jax.config import Config
from remind_jax.config.dotted_keys import nest
from remind_jax.method import get_method
from remind_jax.session.machine_memory import GIB
from remind_jax.sweeps.batches import most_at_once, plan_batch, run_batch, score_batch
from remind_jax.sweeps.delayed import revise
from remind_jax.sweeps.scene_arrays import SceneFrames, describe_scene
from remind_jax.sweeps.settings import Setting

# What a batch costs beside its settings, in settings.
_COST_OF_BATCH = {"cpu": 1}
_USUAL_COST = 64
# A program that is there is used unless another one would save a third of the work.
_WORTH_COMPILING = 1.5


# Takes the numbers of settings and their scores.
Keep = Callable[[Sequence[int], Sequence[dict[str, float]]], None]


@dataclasses.dataclass(frozen=True)
class Progress:
    """How far a sweep is; handed to the caller's function after every batch."""

    scene: str
    num_done: int  # rows
    num_rows: int


class Worker:
    """Keeps what the next settings may need again: capacities, batch size, described frames."""

    def __init__(
        self, config: Config, memory_gib: float, batch: int | None = None, delay: int = 0
    ) -> None:
        """Takes capacities and the method of `config`; all else comes with the scene.

        Args:
          memory_gib: Memory that the compiled program may take, on each device.
          batch: Settings side by side; chosen by memory if left out.
          delay: Frames that answers wait.
        """
        self._delay = delay
        self.batch, self.program_bytes = 0, 0
        self._static = config.static
        self._budget_bytes, self._wanted = int(memory_gib * GIB), batch
        self._method = get_method(config.tracker)
        self._described_by = self._method.sweeping.described_by
        self._described: tuple[tuple, Any] | None = None

    def start(self, scene: SceneFrames, jobs: Sequence[Mapping[int, Setting]], keep: Keep) -> None:
        """Runs settings, given by number; those of a job have the same descriptors."""
        sizes = [len(job) for job in jobs]
        for job in jobs:
            numbers = list(job)
            frames = self._describe(scene, job[numbers[0]])
            self._choose_batch(scene, frames, sizes)
            while numbers:
                part = numbers[: self.batch]
                # A batch that outgrows its memory is done over, in smaller ones.
                answers, grown = run_batch(
                    frames, scene.config, [job[number] for number in part], self._static,
                    self.batch, self._budget_bytes if self._wanted is None else None,
                )  # fmt: skip
                if answers is not None:
                    answers = revise(answers, self._method, self._delay)
                    keep(part, score_batch(scene, answers, grown, self.batch))
                    numbers = numbers[len(part) :]
                if grown != self._static:
                    self._static = grown
                    self._plan(scene, frames, self.batch)

    def finish(self) -> None:
        """Nothing is left to do: `start` returns when all is done."""

    def stop(self) -> None:
        """Nothing goes on by itself."""

    def _describe(self, scene: SceneFrames, setting: Setting) -> Any:
        static = dataclasses.replace(self._static, feature_dim=scene.feats[0].patches.shape[-1])
        # Room that a scene does not need is paid for by every setting, so the first one gets what
        # it needs; what further ones lack is doubled, so that they share programs.
        is_first = self.batch == 0
        make_room = functools.partial(dataclasses.replace, static) if is_first else static.grow
        self._static = make_room(**scene.capacities)
        seen = _under(self._described_by, setting)
        what = (scene.digest, seen, self._static.num_detections)
        if self._described is None or self._described[0] != what:
            config = scene.config.updated({"thresholds": nest(seen)})
            self._described = what, describe_scene(scene, self._static, config)
        return self._described[1]

    def _choose_batch(self, scene: SceneFrames, frames: Any, sizes: Sequence[int]) -> None:
        if self._wanted is not None:
            self.batch = round_to_devices(self._wanted)
            return
        most = most_at_once(self._method, self._static, self._budget_bytes)
        best = fit_batch(sizes, most)
        if self.batch and _cost(sizes, self.batch) <= _WORTH_COMPILING * _cost(sizes, best):
            return
        self._plan(scene, frames, best)

    def _plan(self, scene: SceneFrames, frames: Any, wanted: int) -> None:
        """Sets the batch size to what is wanted, or to less where memory has no room for it."""
        if self._wanted is None:
            self.batch, self.program_bytes = plan_batch(
                frames, scene.config, self._static, wanted, self._budget_bytes
            )


def group_by_description(
    settings: Sequence[Setting], described_by: Sequence[str] | None
) -> list[list[int]]:
    """Indices of settings to which frames look the same (`method.Sweeping.described_by`)."""
    groups: dict[tuple, list[int]] = {}
    for index, setting in enumerate(settings):
        groups.setdefault(tuple(sorted(_under(described_by, setting).items())), []).append(index)
    return list(groups.values())


def fit_batch(sizes: Sequence[int], most: int) -> int:
    """The batch size up to `most` that serves groups of these sizes at least cost."""
    most = min(most, round_to_devices(max(sizes)))
    step = jax.local_device_count()
    candidates = range(step, max(step, most) + 1, step)
    return min(candidates, key=lambda batch: (_cost(sizes, batch), -batch))


def round_to_devices(batch: int) -> int:
    """The next multiple of the number of devices, which share a batch evenly."""
    devices = jax.local_device_count()
    return -(-batch // devices) * devices


def _cost(sizes: Sequence[int], batch: int) -> int:
    beside = _COST_OF_BATCH.get(jax.default_backend(), _USUAL_COST)
    return int(np.sum(-(-np.asarray(sizes) // batch)) * (batch + beside))


def _under(names: Sequence[str] | None, setting: Setting) -> Setting:
    """The part of a setting that is about these thresholds and sections; None: all of them."""
    if names is None:
        return dict(setting)
    return {
        name: value
        for name, value in setting.items()
        if any(f"{name}.".startswith(f"{one}.") for one in names)
    }
