"""Ray workers give the rows of one process; one that dies costs only its own task."""

import collections
import contextlib
import json
import os
import signal
import sys
import time

import numpy as np
import pytest

from remind_jax.backbone.registry import get_backbone
from remind_jax.errors import ConfigError, SweepError
from remind_jax.sources import open_source
from remind_jax.sweeps import draw, sweep
from remind_jax.sweeps.program import SCORES
from remind_jax.sweeps.scene_arrays import load_scene
from tests.sweeps.tiny_sweep import CONFIG, SCENES, SETTINGS, SPACE

# Ray starts its processes by forking, long after JAX has threads; they run something else at once.
pytestmark = pytest.mark.filterwarnings("ignore:os.fork:RuntimeWarning")

EYES = get_backbone("patch-statistics")


def test_without_ray_one_sentence_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "ray", None)
    with pytest.raises(SweepError, match=r"pip install 'remind-jax\[cluster\]'"):
        sweep(SCENES, SETTINGS, config=CONFIG, workers=2)


def test_no_workers_are_no_crew():
    with pytest.raises(ConfigError, match="'workers' is 0"):
        sweep(SCENES, SETTINGS, config=CONFIG, workers=0)


@pytest.mark.parametrize(
    "address", ["127.0.0.1:1", "ray://127.0.0.1:1", "nowhere.invalid:6379", "127.0.0.1:999999"]
)
def test_a_machine_that_does_not_answer_is_not_waited_for(address):
    """Ray itself waits for more than a minute."""
    start = time.monotonic()
    with pytest.raises(SweepError, match=f"nothing answers at '{address}'"):
        sweep(SCENES, SETTINGS, config=CONFIG, cluster=address)
    assert time.monotonic() - start < 30


@pytest.fixture
def two_nodes(monkeypatch):
    """Address of a cluster of two nodes with one CPU each."""
    ray = pytest.importorskip("ray")
    from ray.cluster_utils import Cluster  # pyright: ignore[reportMissingImports]

    # Workers have to find the tests' package, which is not installed.
    monkeypatch.setenv("PYTHONPATH", os.getcwd())
    cluster = Cluster()
    for _ in range(2):
        cluster.add_node(num_cpus=1, object_store_memory=200 << 20, include_dashboard=False)
    yield cluster.address
    ray.shutdown()
    cluster.shutdown()


def workers_at_work(task):
    """Process ids of Ray workers that run a task, as the kernel names them."""
    found = []
    for pid in filter(str.isdigit, os.listdir("/proc")):
        with contextlib.suppress(OSError), open(f"/proc/{pid}/cmdline") as stream:
            if stream.read().startswith(f"ray::{task}"):
                found.append(int(pid))
    return found


class Killer:
    """Kills one worker after the first rows have come back."""

    def __init__(self, task):
        self.task, self.killed = task, []

    def __call__(self, progress):
        if not self.killed:
            self.killed.extend(workers_at_work(self.task)[:1])
            for pid in self.killed:
                os.kill(pid, signal.SIGKILL)


def assert_nothing_repeated_or_lost(folder, number):
    keys = collections.Counter(
        json.loads(line)["key"] for line in (folder / "rows.jsonl").read_text().splitlines()
    )
    assert len(keys) == number, "nothing is lost"
    assert set(keys.values()) == {1}, "nothing is repeated"


def formula(scene, settings):
    no_scores = dict.fromkeys(SCORES, 0.0) | {"Identities": 0}
    return [
        no_scores | {"IDF1": scene.num_frames / 100 + s.get("matching.match", 0.0) / 10}
        for s in settings
    ]


def stand_in(scene, settings, options):
    """What `run_task` does, without a tracker to compile."""
    assert os.environ["PJRT_NPROC"] == "1", "a task has one core, and no more threads for its steps"
    time.sleep(0.5)
    _, _, batch, _ = options
    return formula(scene, settings), batch, 0


def break_down(scene, settings, options):
    raise ZeroDivisionError("no such luck")


@pytest.mark.slow
def test_tasks_go_over_two_nodes_and_survive_a_killed_worker(two_nodes, tmp_path, monkeypatch):
    monkeypatch.setattr("remind_jax.sweeps.cluster.run_task", stand_in)
    settings = draw(SPACE, 16, seed=2)
    killer = Killer("stand_in")
    options = {"config": CONFIG, "batch": 2, "cluster": two_nodes, "out": tmp_path}
    result = sweep(SCENES, settings, progress=killer, **options)
    assert killer.killed, "there must be a worker to kill"
    assert result.complete
    for setting, rows in zip(settings, result.rows, strict=True):
        assert [row.scores for row in rows] == [
            formula(load_scene(open_source(frames), CONFIG, EYES), [setting])[0]
            for frames in SCENES
        ]
    assert_nothing_repeated_or_lost(tmp_path, len(SCENES) * len(settings))

    monkeypatch.setattr("remind_jax.sweeps.cluster.run_task", break_down)
    again = sweep(SCENES, settings, **options)
    assert again.rows == result.rows, "what is there is not run again"
    with pytest.raises(SweepError, match="no such luck"):
        sweep(SCENES, [{"matching.match": 0.123}], **options)


@pytest.mark.slow
def test_rows_of_a_cluster_are_those_of_one_process(two_nodes, tmp_path):
    alone = sweep(SCENES, SETTINGS, config=CONFIG, batch=4)
    killer = Killer("run_task")
    options = {"config": CONFIG, "batch": 4, "cluster": two_nodes, "out": tmp_path}
    spread = sweep(SCENES, SETTINGS, progress=killer, **options)
    assert killer.killed, "there must be a worker to kill"
    assert spread.complete
    np.testing.assert_array_equal(spread.table(), alone.table())
    assert_nothing_repeated_or_lost(tmp_path, len(SCENES) * len(SETTINGS))
