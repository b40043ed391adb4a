"""Many processes and machines: Ray places tasks, retries those that die, and moves the data.

A task is a scene and a batch of settings. Rows are kept by the process that asked for them, as they
come back, so that a task that has to be done again leaves no row twice.
"""

from __future__ import annotations

import socket
from collections.abc import Mapping, Sequence
from typing import Any

from remind_jax.config import Config
from remind_jax.errors import SweepError, first_line
from remind_jax.sweeps.scene_arrays import SceneFrames
from remind_jax.sweeps.settings import Setting
from remind_jax.sweeps.worker import Keep, Worker

SETTINGS_PER_TASK = 32
_ANSWERS_WITHIN_S = 10.0  # a machine that is there
_RETRIES = 5  # of a task whose process or machine died
WorkerOptions = tuple[Config, float, int | None, int]  # as `worker.Worker` takes them
_kept: dict[str, Worker] = {}  # the last one of this process
# A task has one core. XLA would split each step between as many threads as the machine has cores.
_ONE_THREAD = {"PJRT_NPROC": "1"}


class Cluster:
    """A crew of Ray workers; same calls as `worker.Worker`."""

    def __init__(
        self,
        config: Config,
        memory_gib: float,
        batch: int | None,
        workers: int | None,
        address: str | None,
        delay: int,
    ) -> None:
        """Joins a cluster, or starts one on this machine.

        Args:
          batch: Settings side by side in a worker, and settings per task.
          workers: Tasks at the same time; as many as the cluster has CPUs (GPUs) if left out.
          address: Of a running Ray cluster; one is started on this machine if left out.

        Raises:
          SweepError: If Ray is missing, or the cluster cannot be reached.
        """
        self.batch, self.program_bytes = 0, 0
        self._ray = _join(address, workers)
        self._most, self._batch = workers, batch
        self._options = self._ray.put((config, memory_gib, batch, delay))
        self._waiting: list[tuple[Any, dict[int, Setting], Keep]] = []
        self._running: dict[Any, tuple[list[int], Keep]] = {}
        has_gpus = self._ray.cluster_resources().get("GPU", 0) > 0
        self._task = self._ray.remote(
            num_cpus=1,
            num_gpus=1 if has_gpus else 0,
            max_retries=_RETRIES,
            runtime_env={"env_vars": _ONE_THREAD},
        )(run_task)

    def start(self, scene: SceneFrames, jobs: Sequence[Mapping[int, Setting]], keep: Keep) -> None:
        """Hands settings to the cluster; their rows come with `finish`."""
        shown = self._ray.put(scene)
        size = self._batch or SETTINGS_PER_TASK
        for job in jobs:
            numbers = list(job)
            for first in range(0, len(numbers), size):
                part = {number: job[number] for number in numbers[first : first + size]}
                self._waiting.append((shown, part, keep))
        self._submit()

    def finish(self) -> None:
        """Waits for all rows.

        Raises:
          SweepError: If a task fails, or its process dies again and again.
        """
        while self._running:
            done, _ = self._ray.wait(list(self._running), num_returns=1)
            numbers, keep = self._running.pop(done[0])
            try:
                scores, batch, program_bytes = self._ray.get(done[0])
            except self._ray.exceptions.RayError as error:
                self.stop()
                raise SweepError(
                    f"a worker of the cluster failed: {str(error).strip().splitlines()[-1]}"
                ) from error
            self.batch = max(self.batch, batch)
            self.program_bytes = max(self.program_bytes, program_bytes)
            self._submit()
            keep(numbers, scores)

    def stop(self) -> None:
        """Gives up what has not come back."""
        for task in self._running:
            self._ray.cancel(task, force=True)
        self._running.clear()
        self._waiting.clear()

    def _submit(self) -> None:
        while self._waiting and (self._most is None or len(self._running) < self._most):
            shown, part, keep = self._waiting.pop(0)
            task = self._task.remote(shown, list(part.values()), self._options)
            self._running[task] = list(part), keep


def run_task(
    scene: SceneFrames, settings: list[Setting], options: WorkerOptions
) -> tuple[list[dict[str, float]], int, int]:
    """Scores of some settings, the batch size and the bytes of the program; runs in a worker."""
    # Ray keeps processes: what one task compiled and described serves the next.
    known = repr(options)
    if known not in _kept:
        _kept.clear()
        _kept[known] = Worker(*options)
    worker = _kept[known]
    scores: list[dict[str, float]] = []
    jobs = [dict(enumerate(settings))]
    worker.start(scene, jobs, lambda numbers, rows: scores.extend(rows))
    return scores, worker.batch, worker.program_bytes


def _join(address: str | None, workers: int | None) -> Any:
    try:
        import ray  # pyright: ignore[reportMissingImports]
    except ImportError as error:
        raise SweepError(
            "workers need Ray, which is not installed; pip install 'remind-jax[cluster]'"
        ) from error
    if ray.is_initialized():
        return ray
    _check_reachable(address)
    quiet: dict[str, Any] = {"log_to_driver": False, "logging_level": "ERROR"}
    try:
        if address is None:
            # By itself Ray would join any cluster that runs on this machine already.
            ray.init(address="local", num_cpus=workers, include_dashboard=False, **quiet)
        else:
            ray.init(address=address, **quiet)
    except (ConnectionError, RuntimeError, ValueError) as error:
        raise SweepError(f"cannot join the Ray cluster at '{address}': {error}") from error
    return ray


def _check_reachable(address: str | None) -> None:
    """Ray itself waits for minutes for a machine that does not answer."""
    host, colon, port = (address or "").removeprefix("ray://").rpartition(":")
    if not (colon and host and port.isascii() and port.isdecimal()):
        return  # a word that Ray knows or refuses
    try:
        socket.create_connection((host.strip("[]"), int(port[:6])), _ANSWERS_WITHIN_S).close()
    except (OSError, OverflowError, UnicodeError) as error:
        why = getattr(error, "strerror", None) or first_line(error)
        raise SweepError(
            f"nothing answers at '{address}' ({why}); give the address of a Ray cluster that runs, "
            "HOST:PORT, or 'auto' for the one of this machine"
        ) from error
